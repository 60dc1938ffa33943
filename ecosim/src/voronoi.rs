//! Voronoi polygons of plants, from their Delaunay triangulation.

use delaunator::{EMPTY, Point, Triangulation, next_halfedge, triangulate};

/// Neighbours of a plant that triangulation leaves out: one of too few for a mesh, or a twin.
const FEW: usize = 8;

/// Voronoi polygons of sites.
pub(crate) struct Cells<'a> {
    sites: &'a [Point],
    mesh: Triangulation,
    /// Circumcentres of the triangles: the corners of the polygons.
    corners: Vec<[f64; 2]>,
    /// For each site, a half-edge that ends in it, on the rim where there is one; `EMPTY` for
    /// sites that the mesh leaves out.
    arrivals: Vec<usize>,
    polygon: Vec<[f64; 2]>,
    spare: Vec<[f64; 2]>,
    neighbours: Vec<usize>,
}

impl<'a> Cells<'a> {
    /// Triangulates the sites.
    pub(crate) fn new(sites: &'a [Point]) -> Self {
        let mesh = triangulate(sites);
        let corner = |t: &[usize]| circumcentre(&sites[t[0]], &sites[t[1]], &sites[t[2]]);
        let corners = mesh.triangles.chunks_exact(3).map(corner).collect();
        let mut arrivals = vec![EMPTY; sites.len()];
        for edge in 0..mesh.triangles.len() {
            let end = mesh.triangles[next_halfedge(edge)];
            if arrivals[end] == EMPTY || mesh.halfedges[edge] == EMPTY {
                arrivals[end] = edge;
            }
        }
        let (polygon, spare, neighbours) = (Vec::new(), Vec::new(), Vec::new());
        Self { sites, mesh, corners, arrivals, polygon, spare, neighbours }
    }

    /// Returns the polygon of a site within the square of half side `reach` about it.
    pub(crate) fn polygon(&mut self, own: usize, reach: f64) -> &[[f64; 2]] {
        let is_whole = self.go_around(own);
        let site = &self.sites[own];
        let is_inside = |corner: &[f64; 2]| {
            (corner[0] - site.x).abs() <= reach && (corner[1] - site.y).abs() <= reach
        };
        if !is_whole || !self.polygon.iter().all(is_inside) {
            self.cut_square(own, reach);
        }
        &self.polygon
    }

    /// Gathers a site's neighbours and the corners of its polygon in turn; says whether they
    /// go all the way around.
    fn go_around(&mut self, own: usize) -> bool {
        self.polygon.clear();
        self.neighbours.clear();
        let first = self.arrivals[own];
        if first == EMPTY {
            // Twins of other sites, and sites too few for a mesh: everyone is a neighbour.
            let few = 0..self.sites.len().min(FEW);
            self.neighbours.extend(few.filter(|&other| other != own));
            return false;
        }
        let mut arrival = first;
        loop {
            self.neighbours.push(self.mesh.triangles[arrival]);
            self.polygon.push(self.corners[arrival / 3]);
            let departure = next_halfedge(arrival);
            arrival = self.mesh.halfedges[departure];
            if arrival == EMPTY {
                self.neighbours.push(self.mesh.triangles[next_halfedge(departure)]);
                return false;
            }
            if arrival == first {
                return true;
            }
        }
    }

    /// Leaves in `polygon` the square about a site, cut by the bisectors towards its neighbours.
    fn cut_square(&mut self, own: usize, reach: f64) {
        let &Point { x, y } = &self.sites[own];
        self.polygon.clear();
        self.polygon.extend([
            [x - reach, y - reach],
            [x + reach, y - reach],
            [x + reach, y + reach],
            [x - reach, y + reach],
        ]);
        for &neighbour in &self.neighbours {
            let other = &self.sites[neighbour];
            let normal = [other.x - x, other.y - y];
            // Points p with (p - site)·normal = |normal|²/2 are as near to one as to the other.
            let half = 0.5 * (normal[0] * normal[0] + normal[1] * normal[1]);
            if half == 0.0 {
                continue;
            }
            clip(&self.polygon, &mut self.spare, |p| {
                (p[0] - x) * normal[0] + (p[1] - y) * normal[1] - half
            });
            std::mem::swap(&mut self.polygon, &mut self.spare);
        }
    }
}

/// Returns the point as far from `a` as from `b` and `c`; not finite when they lie on a line.
fn circumcentre(a: &Point, b: &Point, c: &Point) -> [f64; 2] {
    let (bx, by, cx, cy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let (b2, c2) = (bx * bx + by * by, cx * cx + cy * cy);
    let scale = 0.5 / (bx * cy - by * cx);
    [a.x + (cy * b2 - by * c2) * scale, a.y + (bx * c2 - cx * b2) * scale]
}

/// Leaves in `inside` the part of a convex polygon where `beyond` is not positive.
fn clip(polygon: &[[f64; 2]], inside: &mut Vec<[f64; 2]>, beyond: impl Fn([f64; 2]) -> f64) {
    inside.clear();
    let Some(&last) = polygon.last() else { return };
    let (mut from, mut from_beyond) = (last, beyond(last));
    for &to in polygon {
        let to_beyond = beyond(to);
        if (from_beyond > 0.0) != (to_beyond > 0.0) {
            let t = from_beyond / (from_beyond - to_beyond);
            inside.push([from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]);
        }
        if to_beyond <= 0.0 {
            inside.push(to);
        }
        (from, from_beyond) = (to, to_beyond);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    fn area(polygon: &[[f64; 2]]) -> f64 {
        let last = polygon.len() - 1;
        let cross = |i: usize| {
            let (a, b) = (polygon[if i == 0 { last } else { i - 1 }], polygon[i]);
            a[0] * b[1] - a[1] * b[0]
        };
        0.5 * (0..polygon.len()).map(cross).sum::<f64>().abs()
    }

    #[test]
    fn the_polygon_of_a_hexagonal_lattice_is_a_hexagon() {
        let sites: Vec<Point> = (0..81)
            .map(|i| {
                let (column, row) = (f64::from(i % 9), f64::from(i / 9));
                Point { x: column + 0.5 * (row % 2.0), y: row * 0.75f64.sqrt() }
            })
            .collect();
        let mut cells = Cells::new(&sites);
        let polygon = cells.polygon(40, 2.0);
        // Sites one apart: the cell's area is √3/2, its corners 1/√3 away.
        assert!((area(polygon) - 0.75f64.sqrt()).abs() < 1e-12);
        for corner in polygon {
            let away = (corner[0] - sites[40].x).hypot(corner[1] - sites[40].y);
            assert!((away - 1.0 / 3.0f64.sqrt()).abs() < 1e-12);
        }
    }

    #[test]
    fn polygons_from_circumcentres_and_from_bisectors_are_the_same() {
        let mut stream = Seed(4).stream("sites", 0);
        let sites: Vec<Point> =
            (0..400).map(|_| Point { x: stream.unit(), y: stream.unit() }).collect();
        let mut cells = Cells::new(&sites);
        for own in 0..sites.len() {
            let walked = area(cells.polygon(own, 0.2));
            cells.cut_square(own, 0.2);
            assert!((walked - area(&cells.polygon)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_site_that_the_mesh_leaves_out_has_its_square() {
        let one = [Point { x: 3.0, y: 4.0 }];
        assert_eq!(area(Cells::new(&one).polygon(0, 0.5)), 1.0);
        let two = [Point { x: 0.0, y: 0.0 }, Point { x: 1.0, y: 0.0 }];
        assert_eq!(area(Cells::new(&two).polygon(0, 1.0)), 3.0);
    }
}
