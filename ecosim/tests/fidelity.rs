//! How evenly plants stand and how truly they follow what is painted: small cases of the table in
//! `docs/planting.md`, which `benches/peers/planting` measures beside other methods.

mod painting;

use painting::{Painting, energy, painted, power, relaxed};
use weald_ecosim::{Part, Relaxation, Weight, polish, relax, systematic};

fn curve(painting: &Painting) -> Vec<[f64; 2]> {
    let cells = systematic(Part::whole(painting.side, painting.side), &painting.expected);
    painting.places(&cells, 1)
}

#[test]
fn relaxed_plants_of_the_curve_follow_a_painting() {
    let picture = Painting::new(240, 4_000.0, painted);
    let start = curve(&picture);
    assert_eq!(start.len(), 4_000);
    let places = relaxed(&picture, start, 10);
    let (error, spread) = (picture.count_error(&places, 256.0), picture.unevenness(&places));
    // White noise would give 1/√256 = 0.0625 and 0.52.
    assert!(error < 0.015 && spread < 0.08, "{error} {spread}");
}

#[test]
fn analytic_densities_are_met_in_every_strip() {
    type Density = fn(f64, f64) -> f64;
    // Its integral from the west edge, as a part of the whole.
    type Integral = fn(f64) -> f64;
    let densities: [(Density, Integral); 3] =
        [(|_, _| 1.0, |u| u), (|u, _| 2.0 * u, |u| u * u), (|u, _| 3.0 * u * u, |u| u * u * u)];
    for (density, integral) in densities {
        let painting = Painting::new(160, 3_000.0, density);
        let places = relaxed(&painting, curve(&painting), 10);
        for strip in 0..8 {
            let edges = [f64::from(strip) / 8.0, f64::from(strip + 1) / 8.0];
            let is_in = |p: &&[f64; 2]| (edges[0]..edges[1]).contains(&(p[0] / 160.0));
            let count = places.iter().filter(is_in).count() as f64;
            let wanted = 3_000.0 * (integral(edges[1]) - integral(edges[0]));
            // A strip has two sides of some fifty plants, each of which is in or out by half.
            assert!((count - wanted).abs() < 8.0 + 0.02 * wanted, "{strip}: {count} for {wanted}");
        }
    }
}

#[test]
fn many_passes_keep_to_the_paint_as_a_plain_weight_does_not() {
    let picture = Painting::new(240, 4_000.0, painted);
    let start = curve(&picture);
    let error = |passes, weight| {
        let (mut places, grid) = (start.clone(), picture.grid());
        for pass in 0..passes {
            relax(&mut places, &grid, &Relaxation::weighted(weight, pass, passes));
        }
        picture.count_error(&places, 64.0)
    };
    let [early, late] = [20, 100].map(|passes| error(passes, Weight::Squared));
    assert!(late < 1.4 * early, "{late} after {early}");
    assert!(error(100, Weight::Density) > 2.0 * late);
}

#[test]
fn lattices_have_the_energies_that_are_known_on_paper() {
    let side = 60.0;
    let square: Vec<[f64; 2]> =
        (0..3600).map(|i| [f64::from(i % 60) + 0.5, f64::from(i / 60) + 0.5]).collect();
    // Second moments of a unit square and of a hexagon of area 1: 1/6 and 5/(18 √3).
    let known = 18.0 * 3.0f64.sqrt() / 30.0;
    assert!((energy(&square, side) - known).abs() < 0.002, "{}", energy(&square, side));
    let across = (2.0 / 3.0f64.sqrt()).sqrt();
    let rows = (side / (across * 0.75f64.sqrt())).round() as i32;
    let columns = (side / across).round() as i32;
    let hexagons: Vec<[f64; 2]> = (0..rows * columns)
        .map(|i| {
            let (column, row) = (f64::from(i % columns), f64::from(i / columns));
            let x = (column + 0.25 + 0.5 * (row % 2.0)) * side / f64::from(columns);
            [x, (row + 0.5) * side / f64::from(rows)]
        })
        .collect();
    assert!((energy(&hexagons, side) - 1.0).abs() < 0.005, "{}", energy(&hexagons, side));
}

#[test]
fn relaxation_comes_near_the_hexagonal_limit_and_empties_the_low_waves() {
    let even = Painting::new(100, 2_500.0, |_, _| 1.0);
    let side = 100.0;
    let start = curve(&even);
    let places = relaxed(&even, start.clone(), 20);
    let mut polished = places.clone();
    polish(&mut polished, &even.grid(), 10);
    let [raw, lloyd, power_cells] = [&start, &places, &polished].map(|p| energy(p, side));
    assert!(raw > 1.1 && lloyd < 1.035 && power_cells < 1.03, "{raw} {lloyd} {power_cells}");
    let low = |places: &[[f64; 2]]| power(places, side, [0.1, 0.4]);
    // White noise has 1.
    assert!(low(&places) < 0.02, "{}", low(&places));
    assert!(low(&polished) < 0.3 * low(&places), "{} {}", low(&polished), low(&places));
}
