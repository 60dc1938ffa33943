//! Species that come with the program: the files of `scenes/species/`, as they were at build time.

/// Name and text of every species file, sorted by name.
pub const SPECIES: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/species.rs"));

/// The text of a species file that comes with the program.
pub fn species(name: &str) -> Option<&'static str> {
    SPECIES.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_sorted_and_unique() {
        assert!(SPECIES.windows(2).all(|pair| pair[0].0 < pair[1].0));
        assert_eq!(species("no such plant"), None);
    }
}
