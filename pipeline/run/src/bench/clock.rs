//! Wall clock and processor time of a piece of work.

use std::time::Instant;

/// Both clocks since a moment.
pub(super) struct Stopwatch {
    began: Instant,
    cpu_seconds: f64,
}

impl Stopwatch {
    pub(super) fn start() -> Self {
        Self { began: Instant::now(), cpu_seconds: cpu_seconds().unwrap_or(0.0) }
    }

    /// Seconds and processor seconds since the start. The first are never 0, so that rates exist.
    pub(super) fn read(&self) -> (f64, f64) {
        let cpu_seconds = cpu_seconds().unwrap_or(0.0) - self.cpu_seconds;
        (self.began.elapsed().as_secs_f64().max(1e-9), cpu_seconds.max(0.0))
    }
}

/// Processor seconds of all living threads of this process, where the system tells them.
///
/// Linux counts nanoseconds for each thread in `schedstat`, and hundredths of a second for the
/// process in `stat`; the first is absent from some kernels. Threads that ended are missing from
/// the first, but those of a pool live on.
fn cpu_seconds() -> Option<f64> {
    nanoseconds_of_threads().filter(|sum| *sum > 0.0).map(|sum| sum * 1e-9).or_else(ticks)
}

fn nanoseconds_of_threads() -> Option<f64> {
    let threads = std::fs::read_dir("/proc/self/task").ok()?;
    let of_thread = |entry: std::io::Result<std::fs::DirEntry>| {
        let text = std::fs::read_to_string(entry.ok()?.path().join("schedstat")).ok()?;
        text.split_whitespace().next()?.parse::<f64>().ok()
    };
    Some(threads.filter_map(of_thread).sum())
}

fn ticks() -> Option<f64> {
    /// Linux shows times to programs in hundredths of a second on every architecture.
    const TICKS_A_SECOND: f64 = 100.0;
    let line = std::fs::read_to_string("/proc/self/stat").ok()?;
    // User and system time are fields 14 and 15; the name before them ends in `)`.
    let fields = line.rsplit(')').next()?.split_whitespace().skip(11).take(2);
    let times: Vec<f64> = fields.filter_map(|field| field.parse().ok()).collect();
    Some(times.iter().sum::<f64>() / TICKS_A_SECOND)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_time_is_hardly_more_than_the_time_of_all_threads() {
        let watch = Stopwatch::start();
        let mut sum = 0u64;
        while watch.began.elapsed().as_millis() < 30 {
            sum = std::hint::black_box(sum + 1);
        }
        let (seconds, cpu_seconds) = watch.read();
        let cores = std::thread::available_parallelism().map_or(1, usize::from) as f64;
        assert!(seconds >= 0.03);
        // Other tests run in threads of this process at the same time.
        assert!(cpu_seconds <= seconds * cores + 0.05, "{cpu_seconds} in {seconds}");
    }
}
