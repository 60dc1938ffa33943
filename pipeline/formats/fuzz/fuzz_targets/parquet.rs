//! Parquet as plants, instances and as any table; the reader takes files only.
//!
//! Panics of the parquet crate are contained by our reader, but libFuzzer's panic hook would
//! stop at them: it is replaced, so that only panics that reach us count.
#![no_main]
use std::io::Write;
use std::sync::Once;

static QUIET: Once = Once::new();

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    QUIET.call_once(|| std::panic::set_hook(Box::new(|_| {})));
    let Ok(mut file) = tempfile::Builder::new().suffix(".parquet").tempfile() else { return };
    if file.write_all(bytes).is_err() {
        return;
    }
    let path = file.path();
    let all = || {
        let _ = weald_formats::read_population(path);
        let _ = weald_formats::read_instances(path);
        let _ = weald_formats::read_table(path);
        let _ = weald_formats::provenance(path);
    };
    if std::panic::catch_unwind(all).is_err() {
        std::process::abort();
    }
});
