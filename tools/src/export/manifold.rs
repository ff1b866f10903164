//! A closed surface of which every edge belongs to two triangles, as collision checkers, slicers and
//! Boolean operations want it.
//!
//! In: triangles that are closed, but where four or more may meet in one edge, and where two solids may
//! touch in one vertex: surface nets and the joining of triangles make such places. Out: the same solid
//! with these places cut apart by a tenth of a millimetre.

use nalgebra::{Point3, Vector3};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::f64::consts::TAU;

/// How far what is cut apart is moved into its own solid, metres.
const APART_M: f64 = 1e-4;
/// Most times that edges are cut: an edge of eight triangles waits for at most 16 others.
const ROUNDS: usize = 20;

/// Places of vertices, and the triangles of them, counterclockwise seen from outside.
pub type Triangulated = (Vec<Point3<f64>>, Vec<[u32; 3]>);

/// The same surface, every edge of it in two triangles.
pub fn manifold((mut places, triangles): Triangulated) -> Triangulated {
    let mut triangles = without_flaps(triangles);
    for _ in 0..ROUNDS {
        let crowded = crowded_edges(&triangles);
        if crowded.is_empty() {
            break;
        }
        cut_edges(&mut places, &mut triangles, &crowded);
    }
    part_vertices(&mut places, &mut triangles);
    (places, triangles)
}

/// Without triangles that lie back to back, which enclose nothing.
fn without_flaps(triangles: Vec<[u32; 3]>) -> Vec<[u32; 3]> {
    let mut of_corners: HashMap<[u32; 3], Vec<usize>> = HashMap::new();
    for (number, triangle) in triangles.iter().enumerate() {
        let mut corners = *triangle;
        corners.sort_unstable();
        of_corners.entry(corners).or_default().push(number);
    }
    let mut stays = vec![true; triangles.len()];
    for same in of_corners.values() {
        let (even, odd): (Vec<usize>, Vec<usize>) =
            same.iter().copied().partition(|number| is_turned_as_sorted(&triangles[*number]));
        for (a, b) in even.into_iter().zip(odd) {
            (stays[a], stays[b]) = (false, false);
        }
    }
    triangles.into_iter().zip(stays).filter(|(_, stays)| *stays).map(|(t, _)| t).collect()
}

/// True where the corners come in rising order, wherever one begins.
fn is_turned_as_sorted([a, b, c]: &[u32; 3]) -> bool {
    [[a, b, c], [b, c, a], [c, a, b]].iter().any(|turned| turned.is_sorted())
}

/// An edge, the lower vertex first.
type Edge = [u32; 2];

/// The edges of a triangle, each as it is gone along.
fn directed_edges([a, b, c]: [u32; 3]) -> [Edge; 3] {
    [[a, b], [b, c], [c, a]]
}

/// The triangles of each edge.
fn triangles_of_edges(triangles: &[[u32; 3]]) -> BTreeMap<Edge, Vec<usize>> {
    let mut all: BTreeMap<Edge, Vec<usize>> = BTreeMap::new();
    for (number, triangle) in triangles.iter().enumerate() {
        for [from, to] in directed_edges(*triangle) {
            all.entry([from.min(to), from.max(to)]).or_default().push(number);
        }
    }
    all
}

/// Edges of more than two triangles, with them.
fn crowded_edges(triangles: &[[u32; 3]]) -> Vec<(Edge, Vec<usize>)> {
    triangles_of_edges(triangles).into_iter().filter(|(_, around)| around.len() > 2).collect()
}

/// Gives each pair of triangles that bounds one solid a middle of the edge of its own. Edges of which a
/// triangle was cut already wait for the next round.
fn cut_edges(
    places: &mut Vec<Point3<f64>>,
    triangles: &mut Vec<[u32; 3]>,
    crowded: &[(Edge, Vec<usize>)],
) {
    let mut is_cut: BTreeSet<usize> = BTreeSet::new();
    for (edge, around) in crowded {
        if around.iter().any(|number| is_cut.contains(number)) {
            continue;
        }
        is_cut.extend(around);
        for Wedge { bounds, inwards } in wedges(places, triangles, *edge, around) {
            let middle = nalgebra::center(&places[edge[0] as usize], &places[edge[1] as usize]);
            places.push(middle + inwards * APART_M);
            let middle = places.len() as u32 - 1;
            for number in bounds {
                let halves = halved(triangles[number], *edge, middle);
                triangles[number] = halves[0];
                triangles.push(halves[1]);
            }
        }
    }
}

/// A triangle in two, cut from the middle of an edge to the corner that faces it.
fn halved(triangle: [u32; 3], edge: Edge, middle: u32) -> [[u32; 3]; 2] {
    edge.map(|end| triangle.map(|corner| if corner == end { middle } else { corner }))
}

/// Two triangles that meet in an edge and bound one solid there.
struct Wedge {
    bounds: [usize; 2],
    /// Unit direction from the edge into the solid.
    inwards: Vector3<f64>,
}

/// The solids that meet in an edge.
fn wedges(
    places: &[Point3<f64>],
    triangles: &[[u32; 3]],
    edge: Edge,
    around: &[usize],
) -> Vec<Wedge> {
    let [from, to] = edge.map(|end| places[end as usize]);
    let (u, v) = linkage_skill::internals::orthonormal_basis(&(to - from).normalize());
    let turn = |number: usize| {
        let third = triangles[number].into_iter().find(|corner| !edge.contains(corner));
        let way = places[third.unwrap_or(edge[0]) as usize] - from;
        way.dot(&v).atan2(way.dot(&u))
    };
    let along = |number: usize| directed_edges(triangles[number]).contains(&edge);
    let mut ring: Vec<(f64, bool, usize)> =
        around.iter().map(|number| (turn(*number), along(*number), *number)).collect();
    ring.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut found = Vec::new();
    // A triangle that goes along the edge has its solid behind it, up to one that goes back.
    while let Some(i) = (0..ring.len()).find(|i| {
        let before = (i + ring.len() - 1) % ring.len();
        ring[*i].1 && !ring[before].1
    }) {
        let before = (i + ring.len() - 1) % ring.len();
        let ((end, _, a), (begin, _, b)) = (ring[i], ring[before]);
        let half = begin + 0.5 * (end - begin).rem_euclid(TAU);
        let inwards = u * half.cos() + v * half.sin();
        found.push(Wedge { bounds: [a, b], inwards });
        ring.retain(|(_, _, number)| *number != a && *number != b);
    }
    found
}

/// Gives each fan of triangles round a vertex a vertex of its own: where two solids touch in one.
fn part_vertices(places: &mut Vec<Point3<f64>>, triangles: &mut [[u32; 3]]) {
    let neighbours = triangles_of_edges(triangles);
    let mut of_vertices: Vec<Vec<usize>> = vec![Vec::new(); places.len()];
    for (number, triangle) in triangles.iter().enumerate() {
        triangle.iter().for_each(|corner| of_vertices[*corner as usize].push(number));
    }
    let mut parted = Vec::new();
    for (vertex, around) in of_vertices.iter().enumerate() {
        let fans = fans(vertex as u32, around, triangles, &neighbours);
        parted.extend(fans.into_iter().skip(1).map(|fan| (vertex, fan)));
    }
    for (vertex, fan) in parted {
        let outwards: Vector3<f64> =
            fan.iter().map(|number| area(places, triangles[*number])).sum();
        let outwards = outwards.try_normalize(1e-15).unwrap_or_else(Vector3::zeros);
        places.push(places[vertex] - outwards * APART_M);
        let own = places.len() as u32 - 1;
        for number in fan {
            triangles[number] =
                triangles[number].map(|corner| if corner == vertex as u32 { own } else { corner });
        }
    }
}

/// The triangles round a vertex, by whether edges at the vertex connect them.
fn fans(
    vertex: u32,
    around: &[usize],
    triangles: &[[u32; 3]],
    neighbours: &BTreeMap<Edge, Vec<usize>>,
) -> Vec<Vec<usize>> {
    let mut left: BTreeSet<usize> = around.iter().copied().collect();
    let mut fans = Vec::new();
    while let Some(first) = left.pop_first() {
        let (mut fan, mut front) = (vec![first], vec![first]);
        while let Some(number) = front.pop() {
            let ends = triangles[number].into_iter().filter(|corner| *corner != vertex);
            let edges = ends.map(|end| [vertex.min(end), vertex.max(end)]);
            for beside in edges.filter_map(|edge| neighbours.get(&edge)).flatten() {
                if left.remove(beside) {
                    fan.push(*beside);
                    front.push(*beside);
                }
            }
        }
        fans.push(fan);
    }
    fans
}

/// Normal of a triangle, as long as twice its area.
fn area(places: &[Point3<f64>], triangle: [u32; 3]) -> Vector3<f64> {
    let [a, b, c] = triangle.map(|i| places[i as usize]);
    (b - a).cross(&(c - a))
}

#[cfg(test)]
mod tests {
    use super::super::fused_surface::Samples;
    use super::super::surface_nets::surface_nets;
    use super::*;

    fn volume((places, triangles): &Triangulated) -> f64 {
        let at = |i: u32| places[i as usize].coords;
        triangles.iter().map(|[a, b, c]| at(*a).dot(&at(*b).cross(&at(*c))) / 6.0).sum()
    }

    /// Cells of 1 cm that are solid or not, some of which meet in edges and corners alone.
    fn cells(seed: u64, share: u64) -> Triangulated {
        let n = 11;
        let mut state = seed;
        let mut value = |i: usize| {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            let within = [i % n, i / n % n, i / (n * n)].iter().all(|k| (2..n - 2).contains(k));
            if within && (state >> 33) % 10 < share { -0.005 } else { 0.005 }
        };
        let values = (0..n * n * n).map(&mut value).collect();
        surface_nets(&Samples { counts: [n; 3], step_m: 0.01, origin: Vector3::zeros(), values })
    }

    /// How often an edge is in other than two triangles, and a vertex in other than one fan.
    fn faults((places, triangles): &Triangulated) -> [usize; 2] {
        let of_edges = triangles_of_edges(triangles);
        let edges = of_edges.values().filter(|around| around.len() != 2).count();
        let vertices = (0..places.len() as u32).filter(|vertex| {
            let around: Vec<usize> =
                (0..triangles.len()).filter(|i| triangles[*i].contains(vertex)).collect();
            !around.is_empty() && fans(*vertex, &around, triangles, &of_edges).len() != 1
        });
        [edges, vertices.count()]
    }

    #[test]
    fn cells_that_meet_in_edges_and_corners_are_cut_apart() {
        for (seed, share) in [(1, 2), (2, 4), (3, 5), (4, 7), (5, 8)] {
            let before = cells(seed, share);
            assert!(faults(&before)[0] > 0, "seed {seed} tells nothing");
            let after = manifold(before.clone());
            assert_eq!(faults(&after), [0, 0], "seed {seed}");
            let (was, is) = (volume(&before), volume(&after));
            assert!((is / was - 1.0).abs() < 0.02 && is > 0.0, "seed {seed}: {was} {is} m3");
        }
    }

    #[test]
    fn what_is_sound_stays_as_it_is_and_a_flap_goes() {
        let places: Vec<Point3<f64>> =
            [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]
                .map(Point3::from)
                .into();
        let sound = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
        assert_eq!(manifold((places.clone(), sound.clone())), (places.clone(), sound.clone()));
        let flap = [[1, 2, 4], [2, 1, 4]];
        let with_flap = [sound.as_slice(), &flap].concat();
        assert_eq!(manifold((places.clone(), with_flap)).1, sound);
    }
}
