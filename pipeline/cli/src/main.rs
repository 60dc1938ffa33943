//! `weald`: from bare ground to a finished picture, and everything around it.
//!
//! A thin face over `weald_run`: arguments in, exit code out. Reports go to stdout, progress and
//! errors to stderr.

mod args;
mod commands;
mod progress;
mod say;
mod show;

use clap::Parser;
use std::process::ExitCode;

// Plants grow in many small vectors; this allocator is some ten per cent faster at that.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    hush_contained_panics();
    let args = args::Args::parse();
    match commands::run(&args).and_then(|code| say::heard().map(|()| code)) {
        Ok(code) => code,
        Err(error) => {
            show::error(&error);
            ExitCode::from(error.exit_code())
        }
    }
}

/// Keeps panics silent that a reader of files catches and tells as an error of the file.
fn hush_contained_panics() {
    let told = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if !weald_run::is_panic_contained() {
            told(panic);
        }
    }));
}
