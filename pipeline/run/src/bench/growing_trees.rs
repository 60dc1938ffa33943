//! Plants: trees that organize themselves, and trees of least-cost paths, at sizes up to those of
//! the papers.

use super::{Figure, Size, Time, best, table, wrong};
use crate::error::Result;
use weald_contract::{FromToml, Seed, Value};
use weald_plants::irregular::Irregular;
use weald_plants::self_organizing::{Garden, SelfOrganizing};
use weald_plants::{Form, Stature};

/// Times of growing trees. The largest take seconds each, so they run once.
pub(super) fn figures(size: &Size, quick: bool) -> Result<Vec<Figure>> {
    let once = Size { repeat: 1, ..*size };
    let mut figures = Vec::new();
    let most: &[u32] = if quick { &[20_000] } else { &[80_000, 160_000, 320_000, 642_000] };
    for &metamers in most {
        figures.push(shadows(&once, metamers)?);
    }
    let counts: &[u32] = if quick { &[30_000] } else { &[125_000, 250_000, 500_000, 1_000_000] };
    for &count in counts {
        figures.push(markers(&once, count)?);
    }
    // Nodes and endpoints of the largest tree of Xu and Mould, and less, then of their others.
    let graphs: &[(u32, u32)] = if quick {
        &[(20_000, 2_000)]
    } else {
        &[(43_976, 4_342), (87_952, 8_685), (175_905, 17_370), (351_810, 34_740)]
    };
    for &(nodes, endpoints) in graphs {
        figures.push(one_graph(size, nodes, endpoints)?);
    }
    let levels: &[(u32, u32, u32)] =
        if quick { &[(10, 4, 60)] } else { &[(12, 6, 249), (30, 6, 244), (111, 6, 73)] };
    for &(first, further, nodes) in levels {
        figures.push(many_graphs(size, first, further, nodes)?);
    }
    let trees = if quick { &TABLE_2[..2] } else { &TABLE_2 };
    figures.extend(table_2(size, trees)?);
    Ok(figures)
}

/// The trees of Xu and Mould's table 2: file, and the seconds that theirs took.
const TABLE_2: [(&str, &str, f64); 15] = [
    ("a", include_str!("../../../../scenes/species/irregular/a.toml"), 6.4),
    ("b", include_str!("../../../../scenes/species/irregular/b.toml"), 7.0),
    ("c", include_str!("../../../../scenes/species/irregular/c.toml"), 13.4),
    ("d", include_str!("../../../../scenes/species/irregular/d.toml"), 5.6),
    ("e", include_str!("../../../../scenes/species/irregular/e.toml"), 7.5),
    ("f", include_str!("../../../../scenes/species/irregular/f.toml"), 3.0),
    ("g", include_str!("../../../../scenes/species/irregular/g.toml"), 2.1),
    ("h", include_str!("../../../../scenes/species/irregular/h.toml"), 0.7),
    ("i", include_str!("../../../../scenes/species/irregular/i.toml"), 3.2),
    ("j", include_str!("../../../../scenes/species/irregular/j.toml"), 9.6),
    ("k", include_str!("../../../../scenes/species/irregular/k.toml"), 3.3),
    ("l", include_str!("../../../../scenes/species/irregular/l.toml"), 1.3),
    ("m", include_str!("../../../../scenes/species/irregular/m.toml"), 6.8),
    ("n", include_str!("../../../../scenes/species/irregular/n.toml"), 6.7),
    ("o", include_str!("../../../../scenes/species/irregular/o.toml"), 4.8),
];

/// These trees, from graphs to bare skeletons, and all together.
fn table_2(size: &Size, trees: &[(&str, &str, f64)]) -> Result<Vec<Figure>> {
    let stature =
        Stature { height: 10.0, radius: 4.0, stem_radius: 0.2, maturity: 1.0, vigor: 1.0 };
    let (mut figures, mut all) = (Vec::new(), Time { seconds: 0.0, cpu_seconds: 0.0 });
    for (name, text, theirs) in trees {
        let species: Value =
            Value::parse(0, text).map_err(|problems| wrong(format!("{problems:?}")))?;
        let form = species.as_table().and_then(|table| table.get("form"));
        let mut problems = Vec::new();
        let form = form.and_then(|form| Form::from_toml(form, &mut problems));
        let Some(Form::Irregular(mut form)) = form else {
            return Err(wrong(format!("tree {name}: {problems:?}")));
        };
        form.leaf.count = 0;
        let (time, skeleton) = best(size, || form.grow(&stature, Seed(1)).map_err(wrong))?;
        let (endpoints, nodes) = form.estimate();
        let input = format!(
            "tree {name}: {nodes:.0} nodes, {endpoints:.0} endpoints, {} axes; 2012: {theirs} s",
            skeleton.axes.len()
        );
        all = Time {
            seconds: all.seconds + time.seconds,
            cpu_seconds: all.cpu_seconds + time.cpu_seconds,
        };
        figures.push(Figure::time("irregular, table 2", time, input).with(endpoints));
    }
    let theirs: f64 = trees.iter().map(|(.., seconds)| seconds).sum();
    let input = format!("{} trees; 2012: {theirs:.1} s", trees.len());
    figures.push(Figure::time("irregular, table 2 together", all, input));
    Ok(figures)
}

/// A trunk under half a ball, as the papers begin.
const MUSHROOM: &str = "
    trunk = [{ shape = 'cylinder', to = [0, 0, 4], radius = 0.5 }]
    crown = [{ shape = 'sector', center = [0, 0, 4], radius = 4, half_angle_deg = 90 }]
";

/// Paths through one graph.
fn one_graph(size: &Size, nodes: u32, endpoints: u32) -> Result<Figure> {
    let text = format!("{MUSHROOM}nodes = {nodes}\nbranches = {endpoints}");
    paths("irregular, one graph", size, &text)
}

/// A tree of three further levels, each endpoint with a graph of its own.
fn many_graphs(size: &Size, first: u32, further: u32, nodes: u32) -> Result<Figure> {
    let level = format!("branches = {further}\nrepeat = 3\nnodes = {nodes}");
    let text = format!("{MUSHROOM}nodes = 6000\nbranches = {first}\n[[level]]\n{level}");
    paths("irregular, many graphs", size, &text)
}

fn paths(name: &'static str, size: &Size, text: &str) -> Result<Figure> {
    let form: Irregular = table(text)?;
    let (time, tree) = best(size, || form.tree(1.0, Seed(1)).map_err(wrong))?;
    let report = &tree.report;
    let endpoints = report.endpoints_in_all();
    let input = format!(
        "{} nodes and {endpoints} endpoints in {} graphs, {} edges, {}",
        report.nodes,
        report.graphs,
        report.edges,
        crate::check::bytes_in_words(report.bytes as u64)
    );
    Ok(Figure::time(name, time, input).with(endpoints as f64))
}

/// A tree in the light, grown until it has so many metamers.
fn shadows(size: &Size, metamers: u32) -> Result<Figure> {
    let form: SelfOrganizing = table(&format!(
        "most_metamers = {metamers}\nlambda = 0.5\nshed = 0.02\n\
         shadow = {{ grid = [200, 200, 200], voxel = 1.0, depth = 8 }}"
    ))?;
    grow("self-organizing, light", size, &form, 400.0)
}

/// A tree that colonizes a ball of markers.
fn markers(size: &Size, count: u32) -> Result<Figure> {
    // One marker for each unit of volume.
    let radius = (f64::from(count) * 3.0 / (4.0 * std::f64::consts::PI)).cbrt();
    let form: SelfOrganizing = table(&format!(
        "competition = 'markers'\nmost_metamers = 2000000\nshed_after = 3\nshed = 0.01\n\
         markers = {{ count = {count}, space = [{{ shape = 'ball', center = [0, 0, {radius}], \
         radius = {radius} }}] }}"
    ))?;
    grow("self-organizing, markers", size, &form, 60.0)
}

fn grow(name: &'static str, size: &Size, form: &SelfOrganizing, cycles: f32) -> Result<Figure> {
    let (time, report) = best(size, || {
        let mut garden = Garden::new(form, &[(glam::Vec3::ZERO, 1.0)], Seed(1)).map_err(wrong)?;
        garden.grow_to(cycles).map_err(wrong)?;
        Ok(garden.report())
    })?;
    let metamers = report.metamers[0];
    let input = format!(
        "{metamers} metamers in {} cycles, {} markers left, {}",
        report.cycles,
        report.free_markers,
        crate::check::bytes_in_words(report.bytes as u64)
    );
    Ok(Figure::time(name, time, input).with(metamers as f64))
}
