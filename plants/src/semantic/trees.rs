//! The nine trees of [Ganster07] table 1, as scripts.

/// A tree of the table: its script and what the paper counts.
#[derive(Clone, Copy, Debug)]
pub struct Example {
    /// Name, as `weald plants edit` takes it.
    pub name: &'static str,
    /// The edit script.
    pub script: &'static str,
    /// Branches in the paper.
    pub branches: usize,
    /// Leaves in the paper.
    pub leaves: usize,
    /// Bytes of parameters in the paper; a megabyte is taken as a million bytes.
    pub parameters: usize,
}

macro_rules! examples {
    ($($name:literal $branches:literal $leaves:literal $parameters:literal;)*) => {
        /// All nine, in the order of the paper.
        pub const TREES: [Example; 9] = [$(Example {
            name: $name,
            script: include_str!(concat!("trees/", $name, ".tree")),
            branches: $branches,
            leaves: $leaves,
            parameters: $parameters,
        }),*];
    };
}

examples! {
    "hazel" 2221 17939 1_100_000;
    "oak" 9931 57228 4_700_000;
    "silver_linden" 2211 7048 1_100_000;
    "poplar" 6631 27483 3_100_000;
    "ash" 221 680 106_500;
    "beech" 7517 187_000 3_500_000;
    "maple" 34_001 393_822 15_700_000;
    "birch" 23_011 99_190 10_900_000;
    "plane" 14_373 204_138 7_000_000;
}
