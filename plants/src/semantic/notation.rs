//! Interpolated distributions: the notation of parameters [Ganster07] appendix A.
//!
//! `a-b` leads from `a` to `b` along the parent, `c~d` (or `c±d`) is uniform in `c - d` to
//! `c + d`, and `a~b-c~d` leads from one distribution to another.

use std::fmt;
use std::str::FromStr;

/// A value that may vary along the parent and by chance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distribution {
    /// Mean and greatest deviation at the parent's first node.
    pub from: [f32; 2],
    /// Mean and greatest deviation at the parent's tip; none if the same.
    pub to: Option<[f32; 2]>,
}

impl Distribution {
    /// The same value everywhere.
    pub const fn constant(value: f32) -> Self {
        Self { from: [value, 0.0], to: None }
    }

    /// The value at `t` in [0, 1] along the parent; `u` in [-1, 1) is the chance.
    pub fn at(&self, t: f32, u: f32) -> f32 {
        let [mean, deviation] = self.from;
        let to = self.to.unwrap_or(self.from);
        let between = |a: f32, b: f32| if a == b { a } else { a + (b - a) * t };
        between(mean, to[0]) + between(deviation, to[1]) * u
    }

    /// Least and greatest value.
    pub fn bounds(&self) -> [f32; 2] {
        let (a, b) = (self.from, self.to.unwrap_or(self.from));
        [(a[0] - a[1]).min(b[0] - b[1]), (a[0] + a[1]).max(b[0] + b[1])]
    }
}

impl fmt::Display for Distribution {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let one = |f: &mut fmt::Formatter<'_>, [mean, deviation]: [f32; 2]| match deviation {
            0.0 => write!(f, "{mean}"),
            _ => write!(f, "{mean}~{deviation}"),
        };
        one(f, self.from)?;
        let Some(to) = self.to else { return Ok(()) };
        write!(f, "-")?;
        one(f, to)
    }
}

impl FromStr for Distribution {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (from, rest) = distribution(text)?;
        let Some(rest) = rest.trim_start().strip_prefix('-') else {
            return if rest.trim().is_empty() {
                Ok(Self { from, to: None })
            } else {
                Err(format!("`{}` is too much after `{text}`'s value", rest.trim()))
            };
        };
        let (to, rest) = distribution(rest)?;
        if !rest.trim().is_empty() {
            return Err(format!("`{}` is too much; at most a~b-c~d is allowed", rest.trim()));
        }
        Ok(Self { from, to: Some(to) })
    }
}

/// `number` or `number ~ number`, and what follows.
fn distribution(text: &str) -> Result<([f32; 2], &str), String> {
    let (mean, rest) = number(text)?;
    let trimmed = rest.trim_start();
    let Some(after) = trimmed.strip_prefix('~').or_else(|| trimmed.strip_prefix('±')) else {
        return Ok(([mean, 0.0], rest));
    };
    let (deviation, rest) = number(after)?;
    if deviation < 0.0 {
        return Err(format!("the deviation {deviation} is negative; it must be 0 or more"));
    }
    Ok(([mean, deviation], rest))
}

/// A number, which may begin with a sign, and what follows.
fn number(text: &str) -> Result<(f32, &str), String> {
    let text = text.trim_start();
    let bytes = text.as_bytes();
    let digits = |mut at: usize| {
        while bytes.get(at).is_some_and(u8::is_ascii_digit) {
            at += 1;
        }
        at
    };
    let sign = |at: usize| at + usize::from(matches!(bytes.get(at), Some(b'+' | b'-')));
    let mut end = digits(sign(0));
    if bytes.get(end) == Some(&b'.') {
        end = digits(end + 1);
    }
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let start = sign(end + 1);
        if digits(start) > start {
            end = digits(start);
        }
    }
    let value: f32 = text[..end].parse().map_err(|_| {
        format!("`{text}` does not begin with a number; allowed are a, a-b, a~b and a~b-c~d")
    })?;
    if !value.is_finite() {
        return Err(format!("`{}` is too large a number", &text[..end]));
    }
    Ok((value, &text[end..]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_minus_after_a_value_separates_and_before_a_number_is_its_sign() {
        let read = |text: &str| text.parse::<Distribution>().unwrap();
        let between = |from, to| Distribution { from, to: Some(to) };
        assert_eq!(read("-30--10"), between([-30.0, 0.0], [-10.0, 0.0]));
        assert_eq!(read("12-4"), between([12.0, 0.0], [4.0, 0.0]));
        assert_eq!(read("20±5 - 60 ~ 10"), between([20.0, 5.0], [60.0, 10.0]));
        assert_eq!(read("1e-1-2"), between([0.1, 0.0], [2.0, 0.0]));
        assert_eq!(read("0.5-1").at(0.5, 0.0), 0.75);
        assert_eq!(read("10~2-20~4").at(0.5, 1.0), 18.0);
        for wrong in ["", "a", "1~-2", "1-2-3", "1~", "1e99", "--1"] {
            assert!(wrong.parse::<Distribution>().is_err(), "{wrong}");
        }
    }

    proptest! {
        #[test]
        fn what_is_printed_reads_the_same(
            a in -1e6f32..1e6, b in 0f32..1e3,
            to in proptest::option::of((-1e6f32..1e6, 0f32..1e3)),
        ) {
            let one = Distribution { from: [a, b], to: to.map(|(c, d)| [c, d]) };
            prop_assert_eq!(one.to_string().parse::<Distribution>().unwrap(), one);
        }

        #[test]
        fn no_text_panics(text in "\\PC{0,20}") {
            let _ = text.parse::<Distribution>();
        }
    }
}
