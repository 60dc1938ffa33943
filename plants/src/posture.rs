//! Descriptive models: key postures at several ages and vigors, and all between them
//! interpolated.
//!
//! The second way of [Deussen98] §5 to a plant of any age: rather than simulate its growth, an
//! author draws it at a few ages and vigors, and every number of the drawing follows a line from
//! key to key. Here a drawing is a form of any other generator. `base` holds it whole; each key
//! changes some of its numbers.
//!
//! ```toml
//! [form]
//! generator = "posture"
//! base = { generator = "herb", stems = 4, leaf_length = [0.1, 0.05] }
//! key = [
//!     { age = 0.5, vigor = 1.0, set = { leaf_length = [0.05, 0.02] } },
//!     { age = 3.0, vigor = 0.2, set = { leaf_length = [0.08, 0.03], lean_deg = [10, 60] } },
//!     { age = 3.0, vigor = 1.0, set = {} },
//! ]
//! ```

use crate::skeleton::Skeleton;
use crate::{Form, Stature};
use weald_contract::table::{Entry, Kind, Table};
use weald_contract::{FromToml, Problem, Problems, Seed, Value, Written, table};

table! {
    /// A form whose numbers follow age and vigor.
    pub struct Posture {
        /// The form itself: the `[form]` of any other generator.
        base: Value;
        /// What is different at some ages and vigors.
        key: Written<Vec<Key>>;
    }
}

table! {
    /// What the plant looks like at one age and vigor.
    pub struct Key {
        /// Age, years.
        age: f32, in 0.0..=10000.0;
        /// Vigor.
        vigor: f32 = 1.0, in 0.0..=1.0;
        /// The fields of the base that differ, and their values.
        set: Value;
    }
}

impl Posture {
    /// Everything wrong with the base and with the form at each key.
    pub fn check(&self) -> Problems {
        if self.key.value.is_empty() {
            return vec![Problem::at(self.key.span, "at least one key is needed")];
        }
        let twice = |i: usize| {
            let (keys, key) = (&self.key.value, &self.key.value[i]);
            keys[..i].iter().any(|other| other.age == key.age && other.vigor == key.vigor)
        };
        if let Some(i) = (0..self.key.value.len()).find(|&i| twice(i)) {
            let key = &self.key.value[i];
            let what = format!("two keys stand at age {} and vigor {}", key.age, key.vigor);
            return vec![Problem::at(key.set.span, what)];
        }
        let mut problems = Vec::new();
        for key in &self.key.value {
            match self.at(key.age, key.vigor) {
                Ok(form) => problems.extend(form.check()),
                Err(more) => problems.extend(more),
            }
            // A mistake in the base would be told once for each key.
            if !problems.is_empty() {
                break;
            }
        }
        problems
    }

    /// The form of a plant of this age and vigor.
    ///
    /// Between two ages of one vigor, and then between two vigors, numbers lie on straight lines;
    /// beyond the first and the last they stay. Whole numbers are rounded and so change by jumps:
    /// what is counted had better stay in the base, where generators let parts grow in. What is no
    /// number is that of the nearer key.
    ///
    /// # Errors
    /// What the base's generator finds wrong with it.
    pub fn at(&self, age: f32, vigor: f32) -> Result<Form, Problems> {
        let mut vigors: Vec<f32> = self.key.value.iter().map(|key| key.vigor).collect();
        vigors.sort_by(f32::total_cmp);
        vigors.dedup();
        let rows: Vec<(f32, Value)> = vigors.iter().map(|&row| (row, self.row(row, age))).collect();
        let value = between(&rows, vigor).unwrap_or_else(|| self.base.clone());
        let tag = value.as_table().and_then(|table| table.get("generator"));
        if let Some(tag) = tag.filter(|tag| tag.as_str() == Some("posture")) {
            let what = "the base of postures cannot be made of postures";
            return Err(vec![Problem::at(tag.span, what)]);
        }
        let mut problems = Vec::new();
        match Form::from_toml(&value, &mut problems) {
            Some(form) if problems.is_empty() => Ok(form),
            _ => Err(problems),
        }
    }

    /// The form at an age, between the keys of one vigor.
    fn row(&self, vigor: f32, age: f32) -> Value {
        let keys = self.key.value.iter().filter(|key| key.vigor == vigor);
        let mut keys: Vec<(f32, Value)> =
            keys.map(|key| (key.age, merged(&self.base, &key.set))).collect();
        keys.sort_by(|a, b| a.0.total_cmp(&b.0));
        between(&keys, age).unwrap_or_else(|| self.base.clone())
    }

    /// Grows a plant.
    ///
    /// # Errors
    /// The first thing wrong with the form at this age and vigor.
    pub fn grow(&self, age: f32, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        let first = |problems: Problems| {
            let none = || Problem::new("the postures cannot be read");
            problems.into_iter().next().unwrap_or_else(none)
        };
        let form = self.at(age, stature.vigor).map_err(first)?;
        form.grow(age, stature, seed)
    }
}

/// The value at `x` of the line through values at rising places.
fn between(keys: &[(f32, Value)], x: f32) -> Option<Value> {
    let after = keys.partition_point(|(at, _)| *at <= x);
    let Some((low, before)) = after.checked_sub(1).map(|i| &keys[i]) else {
        return keys.first().map(|(_, value)| value.clone());
    };
    let Some((high, next)) = keys.get(after) else { return Some(before.clone()) };
    Some(mixed(before, next, f64::from((x - low) / (high - low))))
}

/// `base` with the fields of `set` instead of its own; tables are merged field by field.
fn merged(base: &Value, set: &Value) -> Value {
    let (Some(old), Some(new)) = (base.as_table(), set.as_table()) else { return set.clone() };
    let mut table = old.clone();
    for entry in &new.entries {
        match table.entries.iter_mut().find(|own| own.key == entry.key) {
            Some(own) => own.value = merged(&own.value, &entry.value),
            None => table.entries.push(entry.clone()),
        }
    }
    Value { span: base.span, kind: Kind::Table(table) }
}

/// Mixes two trees of the same shape: numbers by their places, all else from the nearer one.
fn mixed(a: &Value, b: &Value, t: f64) -> Value {
    let nearer = if t < 0.5 { a } else { b };
    let kind = match (&a.kind, &b.kind) {
        (Kind::Integer(a), Kind::Integer(b)) => {
            Kind::Integer((*a as f64 + (*b as f64 - *a as f64) * t).round() as i64)
        }
        (Kind::Table(a), Kind::Table(b)) => {
            // A field that one of them lacks has a default that is not known here.
            let entry = |entry: &Entry| match (a.get(&entry.key), b.get(&entry.key)) {
                (Some(a), Some(b)) => Entry { value: mixed(a, b, t), ..entry.clone() },
                _ => entry.clone(),
            };
            let table = if t < 0.5 { a } else { b };
            Kind::Table(Table { entries: table.entries.iter().map(entry).collect() })
        }
        (Kind::Array(a), Kind::Array(b)) if a.len() == b.len() => {
            Kind::Array(a.iter().zip(b).map(|(a, b)| mixed(a, b, t)).collect())
        }
        _ => match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => Kind::Float(a + (b - a) * t),
            _ => nearer.kind.clone(),
        },
    };
    Value { span: nearer.span, kind }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO_BY_TWO: &str = "base = { generator = 'herb', leaf_width = 0.1, head_radius = 0.02 }\n\
        key = [\n\
        { age = 1, vigor = 0, set = { leaf_width = 0.2 } },\n\
        { age = 3, vigor = 0, set = { leaf_width = 0.4 } },\n\
        { age = 1, vigor = 1, set = { leaf_width = 0.6 } },\n\
        { age = 3, vigor = 1, set = { leaf_width = 1.0 } }]";

    fn read(text: &str) -> Posture {
        Posture::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
    }

    fn width(posture: &Posture, age: f32, vigor: f32) -> f32 {
        match posture.at(age, vigor).unwrap() {
            Form::Herb(herb) => herb.leaf_width,
            other => panic!("a herb was asked for, not {other:?}"),
        }
    }

    #[test]
    fn numbers_between_keys_are_bilinear_and_stay_beyond_them() {
        let posture = read(TWO_BY_TWO);
        assert!(posture.check().is_empty());
        for (age, vigor, expected) in [
            (1.0, 0.0, 0.2),
            (3.0, 1.0, 1.0),
            (2.0, 0.0, 0.3),
            (1.0, 0.5, 0.4),
            // The mean of 0.3 and 0.8.
            (2.0, 0.5, 0.55),
            (0.0, 0.0, 0.2),
            (99.0, 1.0, 1.0),
        ] {
            let found = width(&posture, age, vigor);
            assert!((found - expected).abs() < 1e-6, "{age} {vigor}: {found} for {expected}");
        }
    }

    #[test]
    fn whole_numbers_round_and_words_are_those_of_the_nearer_key() {
        let text = "base = { generator = 'herb' }\nkey = [\n\
            { age = 0, set = { stems = 2, flower = 'none' } },\n\
            { age = 4, set = { stems = 5, flower = 'rays' } }]";
        let Form::Herb(herb) = read(text).at(1.0, 1.0).unwrap() else { panic!("no herb") };
        // 2 + 3 / 4 rounds to 3.
        assert_eq!((herb.stems, herb.flower.word()), (3, "none"));
    }

    fn told(text: &str) -> String {
        let problems = read(text).check();
        let span = problems[0].span.unwrap();
        text[span.start as usize..span.end as usize].to_string()
    }

    #[test]
    fn mistakes_are_told_where_they_stand() {
        assert_eq!(told("base = { generator = 'herb' }\nkey = []"), "[]");
        let wrong = "base = { generator = 'herb' }\nkey = [{ age = 1, set = { stemz = 3 } }]";
        assert_eq!(told(wrong), "stemz");
        let nested = "base = { generator = 'posture' }\nkey = [{ age = 1, set = {} }]";
        assert_eq!(told(nested), "'posture'");
        let twice = "base = { generator = 'herb' }\nkey = [{ age = 1, set = {} }, { age = 1, set = { stems = 2 } }]";
        assert_eq!(told(twice), "{ stems = 2 }");
    }
}
