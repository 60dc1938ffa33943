//! Reading typed values out of TOML with every mistake at its own token.
//!
//! A text is parsed once into a tree of [`Value`]s that keep their places. Types declared with
//! [`table!`](macro@crate::table), [`choice!`](macro@crate::choice) and [`words!`](macro@crate::words) read
//! themselves from that tree: unknown keys, wrong types and values out of range are gathered in
//! a list, each with its span, instead of stopping at the first. The same declaration gives the
//! defaults, the JSON Schema and, through `serde`, the canonical parameters of provenance.

use crate::source::{Problem, Problems, Span, nearest};
use serde_json::{Map, json};
use std::ops::RangeInclusive;

pub use serde_json::Value as Json;

/// A parsed value and where it stands.
#[derive(Clone, Debug, PartialEq)]
pub struct Value {
    /// The value's own token (for a table in brackets, its header).
    pub span: Span,
    /// The value.
    pub kind: Kind,
}

/// What a [`Value`] holds.
#[derive(Clone, Debug, PartialEq)]
pub enum Kind {
    /// A table, in the order of its keys.
    Table(Table),
    /// An array.
    Array(Vec<Value>),
    /// A string.
    String(String),
    /// A whole number.
    Integer(i64),
    /// A number with a fraction or exponent.
    Float(f64),
    /// `true` or `false`.
    Boolean(bool),
    /// A date or time; no field of ours takes one.
    Datetime,
}

/// Keys and values of a table.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The entries, sorted by key.
    pub entries: Vec<Entry>,
}

/// One `key = value`.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// The key.
    pub key: String,
    /// Where the key stands.
    pub key_span: Span,
    /// Its value.
    pub value: Value,
}

impl Table {
    /// The value of `key`.
    pub fn get(&self, key: &str) -> Option<&Value> {
        self.entries.iter().find(|entry| entry.key == key).map(|entry| &entry.value)
    }

    /// Sets `key` to `value`, replacing what stood there.
    pub fn set(&mut self, key: &str, value: Value) {
        match self.entries.iter_mut().find(|entry| entry.key == key) {
            Some(entry) => entry.value = value,
            None => self.entries.push(Entry { key: key.into(), key_span: value.span, value }),
        }
    }
}

impl Value {
    /// Parses a TOML text whose index in [`crate::Sources`] is `source`.
    ///
    /// # Errors
    /// Every syntax error, each at its token.
    pub fn parse(source: u32, text: &str) -> Result<Value, Problems> {
        if text.len() > MAX_TEXT_BYTES {
            return Err(vec![Problem::new(format!(
                "the text has {} bytes; at most {MAX_TEXT_BYTES} are read",
                text.len()
            ))]);
        }
        let (table, errors) = toml::de::DeTable::parse_recoverable(text);
        let whole = Span { source, start: 0, end: 0 };
        if errors.is_empty() {
            let kind = Kind::Table(table_from_toml(source, table.into_inner()));
            return Ok(Value { span: whole, kind });
        }
        let problem = |error: toml::de::Error| {
            let span = error.span().map_or(whole, |range| span_of(source, range));
            Problem::at(span, error.message().trim().to_string())
        };
        Err(errors.into_iter().map(problem).collect())
    }

    /// The table inside, if this is one.
    pub fn as_table(&self) -> Option<&Table> {
        match &self.kind {
            Kind::Table(table) => Some(table),
            _ => None,
        }
    }

    /// The string inside, if this is one.
    pub fn as_str(&self) -> Option<&str> {
        match &self.kind {
            Kind::String(text) => Some(text),
            _ => None,
        }
    }

    /// The number inside, whole or not.
    pub fn as_f64(&self) -> Option<f64> {
        match self.kind {
            Kind::Integer(i) => Some(i as f64),
            Kind::Float(f) => Some(f),
            _ => None,
        }
    }

    /// What this is, in words for an error.
    pub fn describe(&self) -> String {
        match &self.kind {
            Kind::Table(_) => "a table".into(),
            Kind::Array(items) => format!("an array of {}", items.len()),
            Kind::String(text) => format!("the text {text:?}"),
            Kind::Integer(i) => format!("{i}"),
            Kind::Float(f) => format!("{f}"),
            Kind::Boolean(b) => format!("{b}"),
            Kind::Datetime => "a date".into(),
        }
    }

    /// Notes that something else was expected here, and gives `None`.
    pub fn expected<T>(&self, expected: &str, problems: &mut Problems) -> Option<T> {
        problems.push(Problem::at(
            self.span,
            format!("expected {expected}, found {}", self.describe()),
        ));
        None
    }
}

/// Longest text that is parsed; scenes and species are a few kilobytes.
const MAX_TEXT_BYTES: usize = 16 << 20;

fn span_of(source: u32, range: std::ops::Range<usize>) -> Span {
    Span { source, start: range.start as u32, end: range.end as u32 }
}

fn table_from_toml(source: u32, table: toml::de::DeTable<'_>) -> Table {
    let entry = |(key, value): (toml::Spanned<_>, toml::Spanned<toml::de::DeValue<'_>>)| Entry {
        key_span: span_of(source, key.span()),
        key: std::borrow::Cow::<'_, str>::into_owned(key.into_inner()),
        value: value_from_toml(source, value),
    };
    Table { entries: table.into_iter().map(entry).collect() }
}

fn value_from_toml(source: u32, value: toml::Spanned<toml::de::DeValue<'_>>) -> Value {
    use toml::de::DeValue;
    let span = span_of(source, value.span());
    let kind = match value.into_inner() {
        DeValue::String(text) => Kind::String(text.into_owned()),
        DeValue::Boolean(b) => Kind::Boolean(b),
        DeValue::Datetime(_) => Kind::Datetime,
        // A whole number beyond i64 is kept as the nearest float: range checks then speak of it.
        DeValue::Integer(i) => match i64::from_str_radix(i.as_str(), i.radix()) {
            Ok(i) => Kind::Integer(i),
            Err(_) => Kind::Float(i.as_str().parse().unwrap_or(f64::INFINITY)),
        },
        DeValue::Float(f) => Kind::Float(f.as_str().parse().unwrap_or(f64::NAN)),
        DeValue::Array(items) => {
            Kind::Array(items.into_iter().map(|item| value_from_toml(source, item)).collect())
        }
        DeValue::Table(table) => Kind::Table(table_from_toml(source, table)),
    };
    Value { span, kind }
}

/// The canonical form is the plain value, without places.
impl serde::Serialize for Value {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        use serde::ser::SerializeMap;
        match &self.kind {
            Kind::Table(table) => {
                let mut map = serializer.serialize_map(Some(table.entries.len()))?;
                for entry in &table.entries {
                    map.serialize_entry(&entry.key, &entry.value)?;
                }
                map.end()
            }
            Kind::Array(items) => serializer.collect_seq(items),
            Kind::String(text) => serializer.serialize_str(text),
            Kind::Integer(i) => serializer.serialize_i64(*i),
            Kind::Float(f) => serializer.serialize_f64(*f),
            Kind::Boolean(b) => serializer.serialize_bool(*b),
            Kind::Datetime => serializer.serialize_unit(),
        }
    }
}

/// A type that reads itself from a TOML value.
pub trait FromToml: Sized {
    /// Reads `value`; on failure adds every problem found and returns `None`.
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self>;

    /// JSON Schema of what is accepted.
    fn schema() -> Json;

    /// Checks numbers inside against `range`; the first one outside it is returned.
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        let _ = range;
        None
    }
}

/// A type that reads itself from some of the keys of a table.
pub trait FromTable: Sized {
    /// The keys this type knows in this table.
    fn keys(table: &Table) -> Vec<&'static str>;

    /// Reads the known keys; leaves unknown ones to [`report_unknown_keys`].
    fn from_table(table: &Table, span: Span, problems: &mut Problems) -> Option<Self>;

    /// JSON Schema of the accepted table.
    fn table_schema() -> Json;
}

/// Reads a whole table into `T`, complaining of keys that `T` does not know.
pub fn read_table<T: FromTable>(value: &Value, problems: &mut Problems) -> Option<T> {
    let Some(table) = value.as_table() else {
        return value.expected("a table", problems);
    };
    let read = T::from_table(table, value.span, problems);
    let clean = report_unknown_keys(table, &T::keys(table), problems);
    read.filter(|_| clean)
}

/// Notes every key of `table` that is not in `known`, with the word that was probably meant.
///
/// Returns whether all keys are known.
pub fn report_unknown_keys(table: &Table, known: &[&str], problems: &mut Problems) -> bool {
    let before = problems.len();
    for entry in table.entries.iter().filter(|entry| !known.contains(&entry.key.as_str())) {
        let problem = Problem::at(entry.key_span, format!("unknown field `{}`", entry.key));
        problems.push(match nearest(&entry.key, known.iter().copied()) {
            Some(near) => problem.hint(format!("did you mean `{near}`?")),
            None => problem.hint(format!("known here: {}", known.join(", "))),
        });
    }
    problems.len() == before
}

/// Reads one field; used by [`table!`](macro@crate::table).
pub fn read_field<T: FromToml>(
    table: &Table,
    span: Span,
    key: &str,
    default: Option<T>,
    range: Option<RangeInclusive<f64>>,
    problems: &mut Problems,
) -> Option<T> {
    let Some(value) = table.get(key) else {
        if default.is_none() {
            problems.push(Problem::at(span, format!("missing field `{key}`")));
        }
        return default;
    };
    let read = T::from_toml(value, problems)?;
    let Some(outside) = range.as_ref().and_then(|range| read.outside(range)) else {
        return Some(read);
    };
    let range = range.unwrap_or(0.0..=0.0);
    let message = format!("`{key}` is {}", number_in_words(outside));
    problems.push(Problem::at(value.span, message).hint(format!(
        "allowed: {} to {}",
        range.start(),
        range.end()
    )));
    None
}

/// A number as a person would write it: with an exponent where it would have many noughts.
fn number_in_words(number: f64) -> String {
    match number.abs() {
        size if size != 0.0 && !(1e-6..1e12).contains(&size) => format!("{number:e}"),
        _ => number.to_string(),
    }
}

/// A value that remembers where it was written, so that later checks can point at it.
///
/// Equality and the canonical form are those of the value alone.
#[derive(Clone, Debug, Default)]
pub struct Written<T> {
    /// The value.
    pub value: T,
    /// Its place.
    pub span: Span,
}

impl<T: PartialEq> PartialEq for Written<T> {
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl<T: serde::Serialize> serde::Serialize for Written<T> {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.value.serialize(serializer)
    }
}

impl<T: FromToml> FromToml for Written<T> {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        Some(Self { value: T::from_toml(value, problems)?, span: value.span })
    }
    fn schema() -> Json {
        T::schema()
    }
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        self.value.outside(range)
    }
}

/// Two groups of keys in one table: what all variants share, and what this variant adds.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Tagged<C, V> {
    /// The keys that every variant has.
    #[serde(flatten)]
    pub common: C,
    /// The variant, chosen by its tag.
    pub variant: V,
}

impl<C: FromTable, V: FromTable> FromToml for Tagged<C, V> {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        let Some(table) = value.as_table() else {
            return value.expected("a table", problems);
        };
        let before = problems.len();
        let variant = V::from_table(table, value.span, problems);
        let common = C::from_table(table, value.span, problems);
        let mut known = V::keys(table);
        // With a misspelt tag every other key would look unknown as well: say it once.
        if variant.is_some() || !known.is_empty() && known.len() > 1 {
            known.extend(C::keys(table));
            report_unknown_keys(table, &known, problems);
        }
        let read = Self { common: common?, variant: variant? };
        (problems.len() == before).then_some(read)
    }
    fn schema() -> Json {
        json!({ "allOf": [C::table_schema(), V::table_schema()] })
    }
}

/// Joins property schemas into an object schema; used by [`table!`](macro@crate::table).
pub fn object_schema(doc: &str, fields: Vec<(&str, &str, Json, bool)>) -> Json {
    let mut properties = Map::new();
    let mut required = Vec::new();
    for (name, field_doc, mut schema, is_required) in fields {
        if let Json::Object(object) = &mut schema {
            object.insert("description".into(), Json::String(field_doc.trim().into()));
        }
        properties.insert(name.into(), schema);
        if is_required {
            required.push(Json::String(name.into()));
        }
    }
    json!({
        "type": "object", "description": doc.trim(),
        "properties": properties, "required": required,
    })
}

/// Declares a struct that is one table of a TOML file.
///
/// Each field is `name: Type;` (required), `name: Type = default;`, and may end in
/// `, in low..=high;` to bound its numbers. Documentation comments become the schema's
/// descriptions.
#[macro_export]
macro_rules! table {
    ($(#[doc = $doc:expr])* pub struct $name:ident {
        $($(#[doc = $fdoc:expr])* $field:ident : $ty:ty $(= $default:expr)? $(, in $range:expr)?;)*
    }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize)]
        pub struct $name { $($(#[doc = $fdoc])* pub $field: $ty,)* }

        impl $crate::table::FromTable for $name {
            fn keys(_: &$crate::table::Table) -> Vec<&'static str> {
                vec![$(stringify!($field)),*]
            }
            #[allow(unused_mut, unused_assignments, reason = "one expansion serves fields with and without default")]
            fn from_table(
                table: &$crate::table::Table,
                span: $crate::Span,
                problems: &mut $crate::Problems,
            ) -> Option<Self> {
                $(
                    let mut default: Option<$ty> = None;
                    $(default = Some($default);)?
                    let mut range: Option<std::ops::RangeInclusive<f64>> = None;
                    $(range = Some($range);)?
                    let $field: Option<$ty> = $crate::table::read_field(
                        table, span, stringify!($field), default, range, problems,
                    );
                )*
                let _ = (table, span, &problems);
                Some(Self { $($field: $field?,)* })
            }
            fn table_schema() -> $crate::table::Json {
                $crate::table::object_schema(concat!($($doc, "\n",)*), vec![$({
                    #[allow(unused_mut, unused_assignments, reason = "one expansion serves fields with and without default")]
                    let required = { let mut required = true; $(let _: fn() -> $ty = || $default; required = false;)? required };
                    (
                        stringify!($field),
                        concat!($($fdoc, "\n",)*),
                        <$ty as $crate::FromToml>::schema(),
                        required,
                    )
                }),*])
            }
        }

        impl $crate::FromToml for $name {
            fn from_toml(value: &$crate::Value, problems: &mut $crate::Problems) -> Option<Self> {
                $crate::table::read_table(value, problems)
            }
            fn schema() -> $crate::table::Json {
                <Self as $crate::table::FromTable>::table_schema()
            }
        }
    };
}

/// Declares an enum whose variant is named by one key of the table.
///
/// `pub enum Operator by "op" { "noise" => Noise(Noise), }`: the table's `op` says which type
/// reads the rest.
#[macro_export]
macro_rules! choice {
    ($(#[doc = $doc:expr])* pub enum $name:ident by $tag:literal {
        $($(#[doc = $vdoc:expr])* $word:literal => $variant:ident($ty:ty),)+
    }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize)]
        #[allow(clippy::large_enum_variant, reason = "a handful of these exist, each read once")]
        pub enum $name { $($(#[doc = $vdoc])* #[serde(rename = $word)] $variant($ty),)+ }

        impl $name {
            /// The word that names this variant in a file.
            pub fn word(&self) -> &'static str {
                match self { $(Self::$variant(_) => $word,)+ }
            }
        }

        impl $crate::table::FromTable for $name {
            fn keys(table: &$crate::table::Table) -> Vec<&'static str> {
                let mut keys = vec![$tag];
                match table.get($tag).and_then(|value| value.as_str()) {
                    $(Some($word) => keys.extend(<$ty as $crate::table::FromTable>::keys(table)),)+
                    _ => {}
                }
                keys
            }
            fn from_table(
                table: &$crate::table::Table,
                span: $crate::Span,
                problems: &mut $crate::Problems,
            ) -> Option<Self> {
                let word = $crate::table::read_field::<$crate::Written<String>>(
                    table, span, $tag, None, None, problems,
                )?;
                match word.value.as_str() {
                    $($word => <$ty as $crate::table::FromTable>::from_table(table, span, problems)
                        .map(Self::$variant),)+
                    _ => {
                        $crate::table::report_unknown_word(&word, $tag, &[$($word),+], problems);
                        None
                    }
                }
            }
            fn table_schema() -> $crate::table::Json {
                let variants = vec![$(
                    $crate::table::tagged_schema($tag, $word, <$ty as $crate::table::FromTable>::table_schema())
                ),+];
                $crate::table::Json::Object([("oneOf".to_string(), variants.into())].into_iter().collect())
            }
        }

        impl $crate::FromToml for $name {
            fn from_toml(value: &$crate::Value, problems: &mut $crate::Problems) -> Option<Self> {
                $crate::table::read_table(value, problems)
            }
            fn schema() -> $crate::table::Json {
                <Self as $crate::table::FromTable>::table_schema()
            }
        }
    };
}

/// Declares an enum that is written as one of a few words.
#[macro_export]
macro_rules! words {
    ($(#[doc = $doc:expr])* pub enum $name:ident {
        $($(#[doc = $vdoc:expr])* $variant:ident = $word:literal,)+
    }) => {
        $(#[doc = $doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
        pub enum $name { $($(#[doc = $vdoc])* #[serde(rename = $word)] $variant,)+ }

        impl $name {
            /// The word for this value in a file.
            pub fn word(self) -> &'static str {
                match self { $(Self::$variant => $word,)+ }
            }
        }

        impl $crate::FromToml for $name {
            fn from_toml(value: &$crate::Value, problems: &mut $crate::Problems) -> Option<Self> {
                let word = <$crate::Written<String> as $crate::FromToml>::from_toml(value, problems)?;
                match word.value.as_str() {
                    $($word => Some(Self::$variant),)+
                    _ => {
                        $crate::table::report_unknown_word(&word, "value", &[$($word),+], problems);
                        None
                    }
                }
            }
            fn schema() -> $crate::table::Json {
                $crate::table::word_schema(&[$($word),+])
            }
        }
    };
}

/// Notes a word that is none of the allowed ones; used by the macros.
pub fn report_unknown_word(
    word: &Written<String>,
    what: &str,
    allowed: &[&str],
    problems: &mut Problems,
) {
    let problem = Problem::at(word.span, format!("unknown {what} `{}`", word.value));
    problems.push(match nearest(&word.value, allowed.iter().copied()) {
        Some(near) => problem.hint(format!("did you mean `{near}`?")),
        None => problem.hint(format!("allowed: {}", allowed.join(", "))),
    });
}

/// Schema of a word out of a list; used by [`words!`](macro@crate::words).
pub fn word_schema(words: &[&str]) -> Json {
    json!({ "type": "string", "enum": words })
}

/// Schema of a variant with its tag fixed; used by [`choice!`](macro@crate::choice).
pub fn tagged_schema(tag: &str, word: &str, mut schema: Json) -> Json {
    if let Some(properties) = schema.get_mut("properties").and_then(Json::as_object_mut) {
        properties.insert(tag.into(), json!({ "const": word }));
    }
    if let Some(required) = schema.get_mut("required").and_then(Json::as_array_mut) {
        required.push(Json::String(tag.into()));
    }
    schema
}

macro_rules! number {
    ($($ty:ty),*) => { $(
        impl FromToml for $ty {
            fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
                match value.as_f64().filter(|number| number.is_finite()) {
                    Some(number) => Some(number as $ty),
                    None => value.expected("a finite number", problems),
                }
            }
            fn schema() -> Json {
                json!({ "type": "number" })
            }
            fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
                let number = f64::from(*self);
                (!range.contains(&number)).then_some(number)
            }
        }
    )* };
}
number!(f32, f64);

macro_rules! whole_number {
    ($($ty:ty),*) => { $(
        impl FromToml for $ty {
            fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
                let Kind::Integer(number) = value.kind else {
                    return value.expected("a whole number", problems);
                };
                match <$ty>::try_from(number) {
                    Ok(number) => Some(number),
                    Err(_) => value.expected(
                        &format!("a whole number from {} to {}", <$ty>::MIN, <$ty>::MAX),
                        problems,
                    ),
                }
            }
            fn schema() -> Json {
                json!({ "type": "integer" })
            }
            fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
                let number = *self as f64;
                (!range.contains(&number)).then_some(number)
            }
        }
    )* };
}
whole_number!(u32, u64, usize, i32, i64);

impl FromToml for bool {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        match value.kind {
            Kind::Boolean(b) => Some(b),
            _ => value.expected("true or false", problems),
        }
    }
    fn schema() -> Json {
        json!({ "type": "boolean" })
    }
}

impl FromToml for String {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        match &value.kind {
            Kind::String(text) => Some(text.clone()),
            _ => value.expected("a text in quotes", problems),
        }
    }
    fn schema() -> Json {
        json!({ "type": "string" })
    }
}

/// The raw value, for tables that another crate reads.
impl FromToml for Value {
    fn from_toml(value: &Value, _: &mut Problems) -> Option<Self> {
        Some(value.clone())
    }
    fn schema() -> Json {
        json!({})
    }
}

impl<T: FromToml> FromToml for Option<T> {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        T::from_toml(value, problems).map(Some)
    }
    fn schema() -> Json {
        T::schema()
    }
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        self.as_ref().and_then(|inner| inner.outside(range))
    }
}

impl<T: FromToml> FromToml for Box<T> {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        T::from_toml(value, problems).map(Box::new)
    }
    fn schema() -> Json {
        T::schema()
    }
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        (**self).outside(range)
    }
}

impl<T: FromToml> FromToml for Vec<T> {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        let Kind::Array(items) = &value.kind else {
            return value.expected("an array", problems);
        };
        // Read all items before giving up, so that every bad one is reported.
        let read: Vec<Option<T>> = items.iter().map(|item| T::from_toml(item, problems)).collect();
        read.into_iter().collect()
    }
    fn schema() -> Json {
        json!({ "type": "array", "items": T::schema() })
    }
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        self.iter().find_map(|item| item.outside(range))
    }
}

impl<T: FromToml, const N: usize> FromToml for [T; N] {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        match &value.kind {
            Kind::Array(items) if items.len() == N => {
                Vec::<T>::from_toml(value, problems)?.try_into().ok()
            }
            _ => value.expected(&format!("an array of {N}"), problems),
        }
    }
    fn schema() -> Json {
        json!({ "type": "array", "items": T::schema(), "minItems": N, "maxItems": N })
    }
    fn outside(&self, range: &RangeInclusive<f64>) -> Option<f64> {
        self.iter().find_map(|item| item.outside(range))
    }
}

impl FromToml for crate::Formula {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        let text = match &value.kind {
            Kind::String(text) => text,
            Kind::Integer(_) | Kind::Float(_) => {
                return value.as_f64().map(|number| crate::Formula::constant(number as f32));
            }
            _ => return value.expected("a formula in quotes, or a number", problems),
        };
        match crate::Formula::parse(text) {
            Ok(formula) => Some(formula),
            Err(error) => {
                // Skip the opening quote. An escape before the place shifts it by its backslash,
                // which single quotes in the formula avoid.
                let span = value.span.narrow(error.span.start + 1..error.span.end + 1);
                problems.push(Problem::at(span, error.message));
                None
            }
        }
    }
    fn schema() -> Json {
        json!({ "type": ["string", "number"] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    table! {
        /// A wave.
        pub struct Wave {
            /// Height, m.
            amplitude: f64 = 0.5, in 0.0..=10.0;
            /// Length, m.
            wavelength: f64;
            /// Name.
            name: Option<String> = None;
        }
    }
    choice! {
        /// An operator.
        pub enum Operator by "op" {
            /// Waves.
            "wave" => Wave(Wave),
        }
    }
    table! {
        /// What operators share.
        pub struct Common {
            /// Whether it runs.
            enabled: bool = true;
        }
    }
    words! {
        /// Order of deaths.
        pub enum Order {
            /// All at once.
            Sync = "sync",
            /// Largest first.
            Greedy = "greedy",
        }
    }

    fn read<T: FromToml>(text: &str) -> (Option<T>, Vec<(String, String)>) {
        let value = Value::parse(0, text).unwrap();
        let mut problems = Vec::new();
        let read = T::from_toml(&value, &mut problems);
        let at = |p: &Problem| {
            let span = p.span.unwrap();
            (text[span.start as usize..span.end as usize].to_string(), p.to_string())
        };
        (read, problems.iter().map(at).collect())
    }

    #[test]
    fn defaults_fill_what_is_not_written() {
        let (wave, problems) = read::<Wave>("wavelength = 3");
        assert_eq!(problems, []);
        let wave = wave.unwrap();
        assert_eq!((wave.amplitude, wave.wavelength, wave.name), (0.5, 3.0, None));
    }

    #[test]
    fn every_mistake_of_a_table_is_told_at_its_own_token() {
        let (wave, problems) = read::<Wave>("amplitude = 40\nwavelenght = 3\nname = 7");
        assert!(wave.is_none());
        let tokens: Vec<&str> = problems.iter().map(|(token, _)| token.as_str()).collect();
        assert_eq!(tokens, ["40", "", "7", "wavelenght"]);
        assert!(problems[0].1.contains("allowed: 0 to 10"));
        assert!(problems[3].1.contains("did you mean `wavelength`?"));
    }

    #[test]
    fn numbers_far_out_are_told_with_an_exponent() {
        let (_, problems) = read::<Wave>("wavelength = 3\namplitude = 1e30");
        assert!(problems[0].1.contains("e30; allowed: 0 to 10"), "{problems:?}");
        assert_eq!(number_in_words(0.0), "0");
        assert_eq!(number_in_words(-40.5), "-40.5");
        assert_eq!(number_in_words(1e-300), "1e-300");
    }

    #[test]
    fn a_tagged_table_shares_its_keys_between_variant_and_common_part() {
        type Entry = Tagged<Common, Operator>;
        let (entry, problems) = read::<Entry>("op = \"wave\"\nwavelength = 2\nenabled = false");
        assert_eq!(problems, []);
        let entry = entry.unwrap();
        assert_eq!((entry.common.enabled, entry.variant.word()), (false, "wave"));
        let (entry, problems) = read::<Entry>("op = \"wavee\"\nwavelength = 2");
        assert!(entry.is_none());
        assert_eq!(problems.len(), 1);
        assert!(problems[0].1.contains("did you mean `wave`?"));
    }

    #[test]
    fn a_word_out_of_a_list_is_read_and_a_near_miss_is_corrected() {
        let value = Value::parse(0, "a = \"greedy\"\nb = \"gredy\"").unwrap();
        let table = value.as_table().unwrap();
        let mut problems = Vec::new();
        let order = Order::from_toml(table.get("a").unwrap(), &mut problems).unwrap();
        assert_eq!((order, order.word(), Order::Sync.word()), (Order::Greedy, "greedy", "sync"));
        assert_eq!(Order::from_toml(table.get("b").unwrap(), &mut problems), None);
        assert!(problems[0].to_string().contains("did you mean `greedy`?"));
    }

    #[test]
    fn syntax_errors_carry_their_place() {
        let problems = Value::parse(0, "a = [1, 2\nb = 3").unwrap_err();
        assert!(problems.iter().all(|p| p.span.is_some()));
        assert!(!problems.is_empty());
    }

    proptest::proptest! {
        #[test]
        fn no_text_makes_the_reader_panic(text in "\\PC{0,200}") {
            if let Ok(value) = Value::parse(0, &text) {
                let mut problems = Vec::new();
                let _ = Tagged::<Common, Operator>::from_toml(&value, &mut problems);
            }
        }
    }
}
