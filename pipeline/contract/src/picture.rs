//! A picture of named channels.

use std::collections::BTreeMap;

/// Floating point channels of one size, linear light, top row first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Texts beside the pixels, by the names they have in OpenEXR: `cryptomatte/1a2b3c4/manifest`.
    pub attributes: BTreeMap<String, String>,
    /// The channels, by the names they have in OpenEXR: `R`, `Z`, `albedo.R`, `normal.X`.
    pub channels: Vec<Channel>,
}

/// One channel of a [`Picture`].
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Name.
    pub name: String,
    /// One value a pixel, top row first.
    pub values: Vec<f32>,
    /// Whether the file needs 32 bits: depth, positions, ids. Others are stored as 16-bit floats.
    pub is_exact: bool,
}

impl Picture {
    /// A picture without channels.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, ..Self::default() }
    }

    /// Values of the channel with this name.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|channel| channel.name == name).map(|c| c.values.as_slice())
    }

    /// Adds a channel.
    pub fn add(&mut self, name: &str, is_exact: bool, values: Vec<f32>) {
        assert_eq!(values.len(), self.width * self.height, "channel {name} has another size");
        self.channels.push(Channel { name: name.into(), values, is_exact });
    }
}
