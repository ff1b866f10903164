//! A part's surface as triangles.

use super::cuboid::Cuboid;
use super::fused_surface::FusedSurface;
use super::manifold::{Triangulated, manifold};
use super::patch::Patch;
use super::surface_nets::surface_nets;
use meshopt::{SimplifyOptions, VertexDataAdapter, simplify};
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;
use std::fmt::Write;

/// Most triangles of a part, before places where solids touch are cut apart.
pub const MOST_TRIANGLES: usize = 4_000;
/// Fewer triangles are no surface.
const LEAST_TRIANGLES: usize = 20;
/// Smallest share of a part's surface that an unconnected piece of it has: the rest is noise of the depth image.
const LEAST_PIECE: f64 = 0.01;
/// How far the surface may move where triangles are joined, as a share of its extent.
const SIMPLIFICATION: f32 = 0.02;

/// Triangles in a link's frame: a closed surface, every edge of which is in two of them.
#[derive(Clone)]
pub struct Mesh {
    /// The file that a description names, relative to its own.
    pub file: String,
    /// Metres.
    pub vertices: Vec<Point3<f64>>,
    /// Red, green and blue of each vertex, 0 to 1.
    pub colours: Vec<[f64; 3]>,
    /// Counterclockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The surface that was seen of a part, thickened inwards; its box is turned like `like`, its
    /// frame's origin lies at `origin`. `None` with too little surface.
    pub fn fused(patches: &[Patch], like: &Cuboid, origin: &Point3<f64>) -> Option<Self> {
        let surface = FusedSurface::new(patches, like)?;
        let (places, triangles) = surface_nets(&surface.samples());
        let triangles = without_small_pieces(&places, triangles);
        let (places, triangles) = manifold(simplified(places, &triangles)?);
        let normals = normals(&places, &triangles);
        let colours = places.iter().zip(&normals).map(|(p, n)| surface.colour(p, n)).collect();
        let vertices = places.iter().map(|p| p - origin.coords).collect();
        Some(Self { file: String::new(), vertices, colours, triangles })
    }

    /// As a Wavefront OBJ file with the colour behind the place of each vertex.
    pub fn obj(&self, remark: &str) -> String {
        let mut text = format!("# {remark}\n");
        for (p, [r, g, b]) in self.vertices.iter().zip(&self.colours) {
            let _ = writeln!(text, "v {:.5} {:.5} {:.5} {r:.3} {g:.3} {b:.3}", p.x, p.y, p.z);
        }
        for n in normals(&self.vertices, &self.triangles) {
            let _ = writeln!(text, "vn {:.4} {:.4} {:.4}", n.x, n.y, n.z);
        }
        for [a, b, c] in self.triangles.iter().map(|t| t.map(|i| i + 1)) {
            let _ = writeln!(text, "f {a}//{a} {b}//{b} {c}//{c}");
        }
        text
    }
}

/// The triangles of the pieces that are not small.
fn without_small_pieces(places: &[Point3<f64>], triangles: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    let piece_of = pieces(places.len(), &triangles);
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| places[i as usize]);
        (b - a).cross(&(c - a)).norm() / 2.0
    };
    let mut areas = vec![0.0; places.len()];
    triangles.iter().for_each(|t| areas[piece_of[t[0] as usize]] += area(t));
    let least = LEAST_PIECE * areas.iter().sum::<f64>();
    triangles.into_iter().filter(|t| areas[piece_of[t[0] as usize]] >= least).collect()
}

/// For each vertex the number of one vertex of its piece, the same for all that triangles connect.
fn pieces(vertices: usize, triangles: &[[u32; 3]]) -> Vec<usize> {
    let mut leads_to: Vec<usize> = (0..vertices).collect();
    fn first(leads_to: &mut [usize], mut at: usize) -> usize {
        while leads_to[at] != at {
            leads_to[at] = leads_to[leads_to[at]];
            at = leads_to[at];
        }
        at
    }
    for [a, b, c] in triangles.iter().map(|t| t.map(|i| i as usize)) {
        for other in [b, c] {
            let (one, other) = (first(&mut leads_to, a), first(&mut leads_to, other));
            leads_to[one.max(other)] = one.min(other);
        }
    }
    (0..vertices).map(|at| first(&mut leads_to, at)).collect()
}

/// The same surface in fewer triangles; `None` where nothing is left.
fn simplified(places: Vec<Point3<f64>>, triangles: &[[u32; 3]]) -> Option<Triangulated> {
    let centre = places.first()?.coords;
    let flat: Vec<f32> =
        places.iter().flat_map(|p| <[f64; 3]>::from(p.coords - centre)).map(|x| x as f32).collect();
    let bytes: Vec<u8> = flat.iter().flat_map(|x| x.to_ne_bytes()).collect();
    let adapter = VertexDataAdapter::new(&bytes, 12, 0).ok()?;
    let corners = triangles.as_flattened();
    // The library ends the program where more triangles are wanted than there are.
    let wanted = corners.len().min(3 * MOST_TRIANGLES);
    let kept = simplify(corners, &adapter, wanted, SIMPLIFICATION, SimplifyOptions::Prune, None);
    let mut number: HashMap<u32, u32> = HashMap::new();
    let mut left = Vec::new();
    let renumbered = kept.chunks_exact(3).map(|t| {
        [t[0], t[1], t[2]].map(|old| {
            *number.entry(old).or_insert_with(|| {
                left.push(places[old as usize]);
                left.len() as u32 - 1
            })
        })
    });
    let triangles: Vec<[u32; 3]> = renumbered.collect();
    (triangles.len() >= LEAST_TRIANGLES).then_some((left, triangles))
}

/// Normals at vertices, by the area of the triangles around them.
fn normals(vertices: &[Point3<f64>], triangles: &[[u32; 3]]) -> Vec<Vector3<f64>> {
    let mut sums = vec![Vector3::zeros(); vertices.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| vertices[i as usize]);
        let area = (b - a).cross(&(c - a));
        triangle.iter().for_each(|i| sums[*i as usize] += area);
    }
    sums.iter().map(|sum| sum.try_normalize(1e-15).unwrap_or(Vector3::z())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of so many cells to a side, each of two triangles.
    fn square(side: u32) -> Triangulated {
        let corner = |i: u32, j: u32| i * (side + 1) + j;
        let places = (0..=side)
            .flat_map(|i| (0..=side).map(move |j| [f64::from(i), f64::from(j)]))
            .map(|[x, y]| Point3::new(0.01 * x, 0.01 * y, 0.001 * (x * y).sin()))
            .collect();
        let cells = (0..side).flat_map(|i| (0..side).map(move |j| (i, j)));
        let triangles = cells.flat_map(|(i, j)| {
            let [a, b, c, d] =
                [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
            [[a, b, c], [a, c, d]]
        });
        (places, triangles.collect())
    }

    #[test]
    fn small_pieces_are_left_out_and_others_are_kept() {
        let ((mut places, mut triangles), (other, of_other)) = (square(20), square(3));
        let first = places.len() as u32;
        // Of 400 cells, 9 more are above a hundredth, a single one is not.
        places.extend(other.iter().map(|p| p + Vector3::z()));
        triangles.extend(of_other.iter().map(|t| t.map(|i| i + first)));
        let kept = triangles.len();
        let (small, of_small) = square(1);
        let first = places.len() as u32;
        places.extend(small.iter().map(|p| p - Vector3::z()));
        triangles.extend(of_small.iter().map(|t| t.map(|i| i + first)));
        assert_eq!(without_small_pieces(&places, triangles).len(), kept);
        assert_eq!(without_small_pieces(&[], Vec::new()).len(), 0);
    }

    #[test]
    fn surfaces_of_any_size_have_at_most_so_many_triangles() {
        for side in [1, 4, 30, 80] {
            let (places, triangles) = square(side);
            match simplified(places, &triangles) {
                Some((_, fewer)) => {
                    assert!(fewer.len() <= triangles.len() && fewer.len() >= LEAST_TRIANGLES);
                }
                None => assert!(side < 30, "{side}"),
            }
        }
        assert!(simplified(Vec::new(), &[]).is_none());
    }
}
