//! Plant models grown from a species' form, a size, an age and a vigor.
//!
//! A generator writes a [`Skeleton`]: axes made of nodes, and organs placed on them. Meshing
//! ([`mesh::model`]) then sweeps the axes into triangles and leaves the organs instanced. All
//! generators share what follows from [`Stature`]: a plant that is smaller than a mature one of
//! its species has fewer branches and leaves, chosen so that a plant holds nearly all parts of
//! its younger self and small changes of age or vigor make small changes of shape.

pub mod card;
pub mod curve;
pub mod detail;
pub mod foliage;
pub mod frame;
pub mod fruit;
pub mod grass;
pub mod herb;
pub mod irregular;
pub mod look;
pub mod lsystem;
pub mod material;
pub mod measure;
pub mod mesh;
pub mod model_file;
pub mod organ;
pub mod posture;
pub mod presence;
pub mod reed;
pub mod season;
pub mod self_organizing;
pub mod semantic;
pub mod skeleton;
pub mod texture;
pub mod twig;
pub mod volume;
pub mod weber_penn;
pub mod wind;

pub use grass::Grass;
pub use herb::Herb;
pub use irregular::Irregular;
pub use look::{Conditions, Look};
pub use lsystem::Lsystem;
pub use model_file::ModelFile;
pub use posture::Posture;
pub use reed::Reed;
pub use self_organizing::SelfOrganizing;
pub use semantic::Semantic;
pub use skeleton::Skeleton;
pub use weber_penn::WeberPenn;

use weald_contract::{PlantModel, Problem, Problems, Representative, Seed, Size, choice};

/// Version of what this crate makes from equal inputs; part of every cache key.
pub const OUTPUT_VERSION: u32 = 1;

choice! {
    /// How a species is grown: the `[form]` table of its file.
    pub enum Form by "generator" {
        /// A tree or shrub by Weber and Penn.
        "weber_penn" => WeberPenn(WeberPenn),
        /// A tuft of blades.
        "grass" => Grass(Grass),
        /// Tall stems with long leaves and a plume or a cattail.
        "reed" => Reed(Reed),
        /// Leafy stems with flower heads.
        "herb" => Herb(Herb),
        /// Modules that rewrite themselves by productions.
        "lsystem" => Lsystem(Lsystem),
        /// Another form whose numbers follow age and vigor.
        "posture" => Posture(Posture),
        /// A tree made by an edit script.
        "semantic" => Semantic(Semantic),
        /// Somebody's model, scaled.
        "model" => Model(ModelFile),
        /// A tree whose buds compete for light or space.
        "self_organizing" => SelfOrganizing(SelfOrganizing),
        /// A tree of least-cost paths through random graphs.
        "irregular" => Irregular(Irregular),
    }
}

/// Why a plant cannot be grown.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// Something the user wrote.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// A plant of impossible size was asked for.
    #[error("a plant of {species} cannot be {height} m high with a crown of {radius} m")]
    Stature {
        /// Species name.
        species: String,
        /// Height asked for, m.
        height: f32,
        /// Crown radius asked for, m.
        radius: f32,
    },
}

/// The size and health that a generator grows to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stature {
    /// Height, m; at least [`LOWEST`].
    pub height: f32,
    /// Crown radius, m; positive.
    pub radius: f32,
    /// Radius of the stem at its base, m.
    pub stem_radius: f32,
    /// Height as part of the height of an old, vigorous plant, in (0, 1].
    pub maturity: f32,
    /// Vigor in [0, 1].
    pub vigor: f32,
}

/// Height below which nothing is modelled: a lower seedling is drawn this high, m.
pub const LOWEST: f32 = 0.005;

impl Stature {
    /// The stature of a representative of a species of this size.
    ///
    /// # Errors
    /// [`Error::Stature`] if a number is not finite.
    pub fn new(size: &Size, plant: &Representative) -> Result<Self, Error> {
        let finite = [plant.height, plant.radius, plant.vigor].iter().all(|x| x.is_finite());
        // The tallest trees are 116 m; `[size]` allows 150 m.
        if !finite || plant.height > 200.0 {
            let (species, height, radius) = (plant.species.clone(), plant.height, plant.radius);
            return Err(Error::Stature { species, height, radius });
        }
        let height = plant.height.max(LOWEST);
        let natural = size.radius_of_height(height);
        Ok(Self {
            height,
            radius: if plant.radius > 0.0 { plant.radius } else { natural },
            stem_radius: (0.5 * size.stem_diameter_of_height(height)).max(1e-4),
            maturity: (height / size.height).clamp(1e-4, 1.0),
            vigor: plant.vigor.clamp(0.0, 1.0),
        })
    }
}

impl Form {
    /// Everything wrong with the form that its types could not tell.
    pub fn check(&self) -> Problems {
        match self {
            Self::WeberPenn(form) => form.check(),
            Self::Grass(form) => form.check(),
            Self::Reed(form) => form.check(),
            Self::Herb(form) => form.check(),
            Self::Lsystem(form) => form.check(),
            Self::Posture(form) => form.check(),
            Self::Semantic(form) => form.check(),
            Self::Model(_) => Problems::new(),
            Self::SelfOrganizing(form) => form.check(),
            Self::Irregular(form) => form.check(),
        }
    }

    /// Grows a plant of a form that has been checked.
    fn grow(&self, age: f32, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        match self {
            Self::WeberPenn(form) => Ok(form.grow(stature, seed)),
            Self::Grass(form) => Ok(form.grow(stature, seed)),
            Self::Reed(form) => Ok(form.grow(stature, seed)),
            Self::Herb(form) => Ok(form.grow(stature, seed)),
            Self::Lsystem(form) => form.grow(stature, seed),
            Self::Posture(form) => form.grow(age, stature, seed),
            Self::Semantic(form) => form.grow(stature, seed),
            Self::Model(form) => {
                let what = "a model from a file has no skeleton";
                Err(Problem::at(form.file.span, what).hint("it can be scaled, but not grown"))
            }
            Self::SelfOrganizing(form) => form.grow(age, stature, seed),
            Self::Irregular(form) => form.grow(stature, seed),
        }
    }
}

/// Grows the skeleton of a plant: axes and placed organs, not yet meshed.
///
/// # Errors
/// The first problem of [`Form::check`], or a stature that is not finite.
pub fn skeleton(
    form: &Form,
    size: &Size,
    plant: &Representative,
    seed: Seed,
) -> Result<Skeleton, Error> {
    if let Some(problem) = form.check().into_iter().next() {
        return Err(problem.into());
    }
    let stature = Stature::new(size, plant)?;
    Ok(form.grow(plant.age, &stature, seed)?)
}

/// Grows a plant: its skeleton meshed, its organs instanced, its foot at the origin.
///
/// The model is `plant.height` high. The same arguments give the same bytes.
///
/// # Errors
/// The first problem of [`Form::check`], or a stature that is not finite.
pub fn grow(
    name: &str,
    form: &Form,
    size: &Size,
    plant: &Representative,
    seed: Seed,
) -> Result<PlantModel, Error> {
    Ok(mesh::model(name, &skeleton(form, size, plant, seed)?))
}
