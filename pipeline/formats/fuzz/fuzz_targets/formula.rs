//! Formulas.
#![no_main]
use weald_contract::table::{Kind, Value};
use weald_contract::{Formula, FromToml, Problems, Span};

libfuzzer_sys::fuzz_target!(|text: &str| {
    let span = Span { source: 0, start: 0, end: text.len() as u32 };
    let value = Value { span, kind: Kind::String(text.into()) };
    let _ = Formula::from_toml(&value, &mut Problems::new());
});
