//! A species file: what all stages agree on, and a table for each stage that wants its own.

use crate::source::{Problem, Problems};
use crate::table::{FromToml, Json, Value, Written};
use crate::{Size, table};

table! {
    /// A species.
    pub struct Species {
        /// Name for people, for instance "quaking aspen".
        title: String = String::new();
        /// Latin name.
        latin: String = String::new();
        /// Colour of its dots in previews, sRGB 0-255.
        color: [u32; 3] = [90, 140, 60], in 0.0..=255.0;
        /// Allometry.
        size: Size;
        /// How it lives; read by ecosim.
        ecology: Option<Value> = None;
        /// How it looks; read by plants.
        form: Option<Value> = None;
        /// Bark, veins, fruits, seasons; read by plants.
        look: Option<Value> = None;
        /// Where its numbers were published, if they are kept although real trees differ.
        published: Option<String> = None;
        /// What it is made of, if it is a patch of other species rather than a plant.
        group: Option<GroupRecipe> = None;
    }
}

table! {
    /// A patch of plants that is placed and instanced as one.
    pub struct GroupRecipe {
        /// Side of the square patch, m; plants stand inside it and patches tile without gaps.
        side: f32, in 0.05..=50.0;
        /// The plants in it.
        member: Vec<GroupMember>;
    }
}

table! {
    /// One species in a patch.
    pub struct GroupMember {
        /// Species name.
        species: Written<String>;
        /// Plants per m² at vigor 1; the number falls in proportion to vigor.
        per_m2: f32, in 0.0..=1000.0;
        /// Youngest and oldest age, years.
        age: [f32; 2] = [1.0, 3.0], in 0.0..=10000.0;
        /// Spread of vigor about the patch's own.
        vigor_spread: f32 = 0.2, in 0.0..=1.0;
        /// Column of the plants table by which the number is multiplied, 1 where a patch has no value
        /// there: how many daisies a lawn has. The `amount` of a halftone writes one.
        amount: Option<Written<String>> = None;
    }
}

impl Species {
    /// Reads a species file's tree.
    pub fn read(value: &Value, problems: &mut Problems) -> Option<Self> {
        let species = Self::from_toml(value, problems)?;
        if species.form.is_none() && species.group.is_none() {
            problems.push(
                Problem::at(value.span, "a species needs a `[form]` or a `[group]`")
                    .hint("`[form]` says how to grow it, `[group]` which plants it is a patch of"),
            );
            return None;
        }
        Some(species)
    }

    /// JSON Schema of a species file.
    pub fn json_schema() -> Json {
        <Self as FromToml>::schema()
    }
}
