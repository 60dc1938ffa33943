//! The `[terrain]` table: what a scene says about its ground.

use crate::environment::{self, Environment};
use crate::mask::Masks;
use crate::operator::{Blend, Operator};
use weald_contract::table::Tagged;
use weald_contract::{Input, InputKind, Problem, Problems, Span, View, Written, table, words};

words! {
    /// What becomes of cells of the elevation model that have no data.
    pub enum Holes {
        /// They take their nearest neighbour's height.
        Fill = "fill",
        /// The same while the terrain is made; in its layers they have no data.
        Keep = "keep",
    }
}

table! {
    /// `[terrain]`: an elevation model, the operators that shape it, and its water.
    pub struct Config {
        /// Elevation model: GeoTIFF, ESRI ASCII, SRTM's HGT, or an image of heights (PNG, EXR, NPY).
        source: Written<String>;
        /// Side of a pixel of an image of heights, m.
        source_cell: Option<f64> = None, in 0.001..=100000.0;
        /// Altitudes of black and white in an image of heights, m. Floats are metres without them.
        source_heights: Option<[f64; 2]> = None, in -100000.0..=100000.0;
        /// What becomes of cells without data.
        source_holes: Holes = Holes::Fill;
        /// Side of a cell, m. Without it, that of the source.
        cell: Option<Written<f64>> = None, in 0.001..=100000.0;
        /// Operators, first to last.
        op: Vec<Tagged<LayerCommon, Operator>> = Vec::new();
        /// Rain and soil.
        water: Water = Water::default();
        /// Finer patches around views.
        detail: Vec<Detail> = Vec::new();
        /// Part of the source that is kept: west, south, east, north, m from its south-west corner.
        crop: Option<Written<[f64; 4]>> = None, in -1000000.0..=10000000.0;
        /// Layers made beside those that later stages read.
        layers: Vec<Written<String>> = Vec::new();
        /// What those layers need to know: latitude, air, soil.
        environment: Environment = Environment::default();
    }
}

table! {
    /// What every operator of the stack has.
    pub struct LayerCommon {
        /// Name, for messages; chance in the operator hangs on it instead of on its position.
        name: Option<String> = None;
        /// Whether the operator acts.
        enabled: bool = true;
        /// Where it acts; everywhere without one. Several in a list multiply.
        mask: Masks = Masks::default();
        /// How the result joins the ground that was there.
        blend: Blend = Blend::Replace;
        /// Factor on the mask.
        strength: f64 = 1.0, in 0.0..=1.0;
    }
}

table! {
    /// `[terrain.water]`: how much rain falls and what the soil does with it.
    pub struct Water {
        /// Rain that plants live on, m of water.
        rain: f64 = 0.8, in 0.0..=100.0;
        /// Share of the rain that the soil absorbs where it falls; the rest runs downhill.
        absorbed: f64 = 0.2, in 0.0..=1.0;
        /// Water that level soil holds when saturated, m.
        capacity: f64 = 0.5, in 0.001..=100.0;
        /// Way on which running water loses all but 1/e of itself to the soil, m.
        seepage: f64 = 80.0, in 0.01..=1000000.0;
        /// Distance over which soil water evens out sideways (standard deviation), m.
        spread: f64 = 2.0, in 0.0..=1000.0;
        /// Height above open water at which its wetting of the soil has fallen to 1/e, m.
        fringe: f64 = 0.8, in 0.0..=1000.0;
        /// Distance from open water at which its wetting of the soil ends, m.
        fringe_reach: f64 = 25.0, in 0.0..=10000.0;
        /// Whether rain that collects in hollows stands there as water.
        ponds: bool = false;
        /// Map of soil: white holds `capacity`, black nothing.
        soil: Option<Written<String>> = None;
    }
}

impl Default for Water {
    fn default() -> Self {
        Self {
            rain: 0.8,
            absorbed: 0.2,
            capacity: 0.5,
            seepage: 80.0,
            spread: 2.0,
            fringe: 0.8,
            fringe_reach: 25.0,
            ponds: false,
            soil: None,
        }
    }
}

table! {
    /// `[[terrain.detail]]`: a square of finer ground around the place where a view stands.
    pub struct Detail {
        /// Name of the view.
        view: Written<String>;
        /// Side of a cell, m; smaller than that of the terrain.
        cell: Written<f64> = Written { value: 0.25, span: Span::default() }, in 0.001..=100000.0;
        /// Half the side of the square, m.
        radius: f64 = 60.0, in 0.1..=100000.0;
    }
}

impl Config {
    /// Files that this table names: the elevation model, the soil map, the images of masks.
    pub fn inputs(&self) -> Vec<Input> {
        let source = Input {
            field: "terrain.source".into(),
            path: self.source.clone(),
            kind: InputKind::Elevation,
        };
        let soil = self.water.soil.clone().map(|path| Input {
            field: "terrain.water.soil".into(),
            path,
            kind: InputKind::Image,
        });
        let mut inputs: Vec<Input> = [source].into_iter().chain(soil).collect();
        for (index, op) in self.op.iter().enumerate().filter(|(_, op)| op.common.enabled) {
            let images = op.common.mask.0.iter().filter_map(|mask| mask.image.clone());
            let images = images.map(|path| ("mask.image", path));
            let painted = match &op.variant {
                Operator::Layer(edit) => edit.image.clone().map(|path| ("image", path)),
                _ => None,
            };
            let images = images.chain(painted).map(|(field, path)| (field, path, InputKind::Image));
            let models = op.common.mask.0.iter().filter_map(|mask| mask.footprint.as_ref());
            let models =
                models.map(|print| ("mask.footprint.model", print.model.clone(), InputKind::Model));
            inputs.extend(images.chain(models).map(|(field, path, kind)| Input {
                field: format!("terrain.op[{index}].{field}"),
                path,
                kind,
            }));
        }
        inputs
    }

    /// Everything that is wrong and can be told without opening a file.
    pub fn check(&self, views: &[View]) -> Problems {
        let mut problems = Vec::new();
        for op in self.op.iter().filter(|op| op.common.enabled) {
            op.variant.check(&op.common, self, &mut problems);
            op.common.mask.check(&mut problems);
        }
        self.check_names(&mut problems);
        environment::check_names(&self.layers, &mut problems);
        self.environment.check(&mut problems);
        if let Some(crop) = &self.crop {
            let [west, south, east, north] = crop.value;
            if west >= east || south >= north {
                let problem = Problem::at(crop.span, "this rectangle has no inside");
                problems.push(problem.hint("write [west, south, east, north]"));
            }
        }
        for detail in &self.detail {
            detail.check(self.cell.as_ref().map(|cell| cell.value), views, &mut problems);
        }
        problems
    }

    /// Names of the layers that this terrain will have, sorted: what formulas may read.
    pub fn layer_names(&self) -> Vec<&str> {
        environment::wanted(self).into_iter().collect()
    }

    /// Names of the layers that `layers` lists, sorted, `normal` as its three.
    pub fn named_layers(&self) -> std::collections::BTreeSet<&'static str> {
        environment::named(self)
    }

    /// Layers that operators replace or blend.
    pub(crate) fn edited_layers(&self) -> impl Iterator<Item = &str> {
        let edits = self.op.iter().filter(|op| op.common.enabled);
        edits.filter_map(|op| match &op.variant {
            Operator::Layer(edit) => Some(edit.layer.value.as_str()),
            _ => None,
        })
    }

    /// Names key random streams: two operators of one name would be made of the same noise.
    fn check_names(&self, problems: &mut Problems) {
        let names: Vec<&str> = self.op.iter().filter_map(|op| op.common.name.as_deref()).collect();
        for (index, name) in names.iter().enumerate() {
            if names[..index].contains(name) {
                problems.push(
                    Problem::new(format!("two operators of [[terrain.op]] are named `{name}`"))
                        .hint("give each its own name"),
                );
            }
        }
    }
}

impl Detail {
    /// Where the cell is written, or else the view that the detail belongs to.
    pub(crate) fn cell_span(&self) -> Span {
        if self.cell.span == Span::default() { self.view.span } else { self.cell.span }
    }

    fn check(&self, cell: Option<f64>, views: &[View], problems: &mut Problems) {
        if !views.iter().any(|view| view.name == self.view.value) {
            let names: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
            let problem =
                Problem::at(self.view.span, format!("there is no view `{}`", self.view.value));
            problems.push(match names.as_slice() {
                [] => problem.hint("add a [[view]] with this name"),
                _ => problem.hint(format!("views here: {}", names.join(", "))),
            });
        }
        if cell.is_some_and(|cell| self.cell.value >= cell) {
            problems.push(
                Problem::at(self.cell_span(), "a detail's cell must be smaller than the terrain's")
                    .hint(format!("the terrain has cells of {} m", cell.unwrap_or_default())),
            );
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn read(text: &str) -> Result<Config, Problems> {
        let mut problems = Vec::new();
        let config = Config::from_toml(&Value::parse(0, text)?, &mut problems);
        config.ok_or(problems)
    }

    /// The texts that problems point at, and what they say.
    fn complaints(text: &str, views: &[View]) -> Vec<(String, String)> {
        let problems = read(text).map_or_else(|problems| problems, |config| config.check(views));
        let token = |problem: &Problem| {
            let span = problem.span.unwrap_or_default();
            text[span.start as usize..span.end as usize].to_string()
        };
        problems.iter().map(|problem| (token(problem), problem.to_string())).collect()
    }

    #[test]
    fn an_empty_water_table_is_the_default_one() {
        let config = read("source = \"dem.tif\"\nwater = {}").unwrap();
        assert_eq!(config.water, Water::default());
    }

    #[test]
    fn a_mask_may_be_one_table_or_a_list_and_its_images_are_inputs() {
        let config = read(
            "source = \"dem.tif\"\n[[op]]\nop = \"offset\"\nby = 1\nmask = [{ image = \"a.png\" }, \
             { slope_deg = [4, 90], falloff = 2 }]\n[[op]]\nop = \"flatten\"\naltitude = 3\n\
             mask = { image = \"b.png\" }",
        )
        .unwrap();
        let inputs: Vec<(String, String)> =
            config.inputs().into_iter().map(|input| (input.field, input.path.value)).collect();
        let expected = [
            ("terrain.source", "dem.tif"),
            ("terrain.op[0].mask.image", "a.png"),
            ("terrain.op[1].mask.image", "b.png"),
        ];
        assert_eq!(inputs, expected.map(|(field, path)| (field.to_string(), path.to_string())));
    }

    #[test]
    fn every_mistake_is_told_at_its_own_token() {
        let ops = [
            ("op = \"nois\"\n", "\"nois\"", "did you mean `noise`?"),
            ("op = \"smooth\"\nradius = -1\n", "-1", "allowed: 0 to 10000"),
            ("op = \"offset\"\nby = 1\nmask = { slope_deg = [40, 4] }\n", "[40, 4]", "lower end"),
            (
                "op = \"offset\"\nby = 1\nmask = { slope_dge = [4, 9] }\n",
                "slope_dge",
                "`slope_deg`",
            ),
            ("op = \"offset\"\nby = 1\nmask = { formula = \"slpoe > 3\" }\n", "slpoe", "slope"),
            (
                "op = \"offset\"\nby = 1\nmask = { polygon = [[0, 0], [1, 1]] }\n",
                "[[0, 0], [1, 1]]",
                "3",
            ),
            ("op = \"clamp\"\nlow = 5\nhigh = 4\n", "4", "`low`"),
            ("op = \"lake\"\nat = [1, 2]\nlevel = 3\nmask = {}\n", "[1, 2]", "no mask"),
            (
                "op = \"stream\"\npoints = [[1, 1], [1, 1]]\nwidth = 1\ndepth = 1\n",
                "[[1, 1], [1, 1]]",
                "different points",
            ),
        ];
        for (op, token, message) in ops {
            let found = complaints(&format!("source = \"dem.tif\"\n[[op]]\n{op}"), &[]);
            assert_eq!(found.len(), 1, "{op}: {found:?}");
            assert_eq!(found[0].0, token, "{op}");
            assert!(found[0].1.contains(message), "{op}: {}", found[0].1);
        }
    }

    #[test]
    fn a_detail_needs_its_view_and_smaller_cells() {
        let text = "source = \"dem.tif\"\ncell = 1\n[[detail]]\nview = \"bakn\"\ncell = 2\n";
        let found = complaints(text, &[]);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].0.as_str(), found[1].0.as_str()), ("\"bakn\"", "2"));
    }

    proptest::proptest! {
        #[test]
        fn no_table_makes_the_reader_panic(key in "[a-z_]{1,12}", value in "\\PC{0,40}") {
            let text = format!("source = \"d\"\n[[op]]\nop = \"noise\"\n{key} = {value}");
            let _ = read(&text).map(|config| config.check(&[]));
        }
    }
}
