//! Which values a field takes: `FIELD=0.1..0.9:5` or `FIELD=a,b,c`.

use crate::error::{Error, Result};
use std::str::FromStr;

/// Most values of one field.
const MOST_VALUES: usize = 1000;
/// Significant digits of the values between the ends of a range: as many as people would write.
const DIGITS: i32 = 12;

/// A field and the values that it takes, as written after `--set`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sweep {
    /// Way to the field: `ecosim.step[0].years` or `species.aspen.ecology.survival`.
    pub field: String,
    /// Its values.
    pub values: Vec<String>,
}

impl FromStr for Sweep {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let example = "write `FIELD=0.1..0.9:5` for five values, or `FIELD=0.1,0.3,0.7`";
        let Some((field, values)) = text.split_once('=') else {
            return Err(format!("no `=`: {example}"));
        };
        let field = field.trim().to_string();
        if !field.starts_with("ecosim.") && !field.starts_with("species.") {
            return Err(format!(
                "`{field}` changes no simulation: fields of `ecosim.` and `species.` do"
            ));
        }
        let values = match range(values) {
            Some(range) => range.ok_or_else(|| format!("`{values}` is no range: {example}"))?,
            None => list(values),
        };
        if values.is_empty() || values.len() > MOST_VALUES || values.contains(&String::new()) {
            return Err(format!("1 to {MOST_VALUES} values are right: {example}"));
        }
        Ok(Self { field, values })
    }
}

/// Reads `a..b:n`; `None` when the text is something else, `Some(None)` when the range is wrong.
fn range(text: &str) -> Option<Option<Vec<String>>> {
    let (from, rest) = text.split_once("..")?;
    if from.contains(['"', '[']) {
        return None;
    }
    let evenly = || {
        let (to, count) = rest.split_once(':')?;
        let (from, to): (f64, f64) = (from.trim().parse().ok()?, to.trim().parse().ok()?);
        let count: usize = count.trim().parse().ok()?;
        let is_right = from.is_finite() && to.is_finite() && (2..=MOST_VALUES).contains(&count);
        let value = |step: usize| from + (to - from) * step as f64 / (count - 1) as f64;
        is_right.then(|| (0..count).map(|step| plain(value(step))).collect())
    };
    Some(evenly())
}

/// A number with no more digits than people would write: 0.3 and not 0.30000000000000004.
fn plain(value: f64) -> String {
    if value == 0.0 {
        return "0".into();
    }
    let digits = DIGITS - 1 - value.abs().log10().floor() as i32;
    let scale = 10f64.powi(digits.clamp(-300, 300));
    let rounded = (value * scale).round() / scale;
    format!("{rounded}")
}

/// Cuts a list at its commas, but not within brackets or quotes.
fn list(text: &str) -> Vec<String> {
    let (mut values, mut depth, mut is_quoted) = (vec![String::new()], 0i32, false);
    for letter in text.chars() {
        match letter {
            '"' => is_quoted = !is_quoted,
            '[' | '{' if !is_quoted => depth += 1,
            ']' | '}' if !is_quoted => depth -= 1,
            ',' if depth == 0 && !is_quoted => {
                values.push(String::new());
                continue;
            }
            _ => {}
        }
        if let Some(last) = values.last_mut() {
            last.push(letter);
        }
    }
    values.into_iter().map(|value| value.trim().to_string()).collect()
}

/// Every value of one field with every value of the others, the last field fastest; without fields,
/// one empty combination.
pub(super) fn combinations(sweeps: &[Sweep], most: usize) -> Result<Vec<Vec<String>>> {
    let count = sweeps.iter().try_fold(1usize, |n, sweep| n.checked_mul(sweep.values.len()));
    if count.is_none_or(|count| count > most) {
        let message = "this sweep has too many combinations";
        return Err(Error::plain(message, format!("{most} at most are simulated at once")));
    }
    let mut all = vec![Vec::new()];
    for sweep in sweeps {
        let with = |before: &Vec<String>| {
            let before = before.clone();
            sweep
                .values
                .iter()
                .map(move |value| [before.as_slice(), std::slice::from_ref(value)].concat())
        };
        all = all.iter().flat_map(with).collect();
    }
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values(text: &str) -> Vec<String> {
        text.parse::<Sweep>().unwrap().values
    }

    #[test]
    fn ranges_and_lists_give_the_values_that_people_would_write() {
        assert_eq!(values("ecosim.a=0.1..0.9:5"), ["0.1", "0.3", "0.5", "0.7", "0.9"]);
        assert_eq!(values("ecosim.a=10..50:5"), ["10", "20", "30", "40", "50"]);
        assert_eq!(values("ecosim.a=-1..1:3"), ["-1", "0", "1"]);
        assert_eq!(values("ecosim.a=1e-9..3e-9:3"), ["0.000000001", "0.000000002", "0.000000003"]);
        assert_eq!(values("species.b.c= 1, 2 ,x"), ["1", "2", "x"]);
        assert_eq!(values("ecosim.a=[1,2],[3,4],\"p,q\""), ["[1,2]", "[3,4]", "\"p,q\""]);
    }

    #[test]
    fn slips_are_told() {
        for (text, word) in [
            ("ecosim.a", "no `=`"),
            ("render.samples=1,2", "changes no simulation"),
            ("ecosim.a=1..2", "is no range"),
            ("ecosim.a=1..2:1", "is no range"),
            ("ecosim.a=1..x:3", "is no range"),
            ("ecosim.a=1,,2", "values are right"),
            ("ecosim.a=", "values are right"),
        ] {
            let error = text.parse::<Sweep>().unwrap_err();
            assert!(error.contains(word), "{text}: {error}");
        }
    }

    #[test]
    fn all_values_meet_all_others() {
        let sweeps = ["ecosim.a=1,2", "ecosim.b=3,4,5"].map(|text| text.parse().unwrap());
        let all = combinations(&sweeps, 6).unwrap();
        let joined: Vec<String> = all.iter().map(|values| values.join("")).collect();
        assert_eq!(joined, ["13", "14", "15", "23", "24", "25"]);
        assert!(combinations(&sweeps, 5).is_err());
        assert_eq!(combinations(&[], 1).unwrap(), [Vec::<String>::new()]);
    }
}
