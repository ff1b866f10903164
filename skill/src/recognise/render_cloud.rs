//! The surface of an object, and which of it the camera should see in a state.
//!
//! In: a learned appearance (object frame, every joint at configuration 0, metres) and the pose of each part in the
//! camera frame.
//! Out: the visible surfels with their pixels. They are grouped in patches, within which colour is compared.
//! From: a coarse depth buffer (z-buffer) per part.

use super::scene::Scene;
use crate::math::extremes::smaller;
use crate::math::rigid::{Pose, matrix_pose};
use crate::object::appearance::{Appearance, Edge};
use nalgebra::{Point3, Vector3};
use std::collections::{HashMap, HashSet};

/// Surface of an object as surfels.
pub struct Cloud {
    /// Surfels of all parts, object frame at configuration 0.
    pub surfels: Vec<CloudPoint>,
    /// Index of the patch of each surfel.
    pub patches: Vec<usize>,
    /// Part of each patch.
    pub part_of_patch: Vec<usize>,
    /// Some of the known edges of the parts; none in a thinned cloud.
    pub edges: Vec<KnownEdge>,
    /// Width of a patch, metres, by part.
    widths: Vec<f64>,
}

/// Largest number of edges of a part that are tested; they are stored in random order.
const TESTED_EDGES: usize = 300;
/// A thinned cloud keeps one surfel of this many.
const THINNING: usize = 3;

/// One surfel.
#[derive(Clone, Copy)]
pub struct CloudPoint {
    /// Index of the part.
    pub part: usize,
    /// Place, object frame at configuration 0, metres.
    pub point: Point3<f64>,
    /// Unit normal, object frame at configuration 0.
    pub normal: Vector3<f64>,
    /// Colour, L*a*b*.
    pub lab: [f32; 3],
}

impl Cloud {
    /// Unpacks an appearance.
    pub fn new(appearance: &Appearance) -> Self {
        let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
        let surfels = appearance.surfels.iter().map(|s| CloudPoint {
            part: usize::from(s.part),
            point: Point3::from(wide(s.point)),
            normal: wide(s.normal),
            lab: s.lab,
        });
        let mut edges = known_edges(&appearance.edges);
        let mut of_part: HashMap<usize, usize> = HashMap::new();
        edges.retain(|e| {
            let count = of_part.entry(e.part).or_default();
            *count += 1;
            *count <= TESTED_EDGES
        });
        Self { edges, ..Self::of(surfels.collect()) }
    }

    /// Groups surfels in patches; without edges.
    pub fn of(surfels: Vec<CloudPoint>) -> Self {
        let widths = patch_widths(&surfels);
        Self::in_patches(surfels, widths)
    }

    /// Groups surfels in patches that are so wide, metres, by part.
    fn in_patches(surfels: Vec<CloudPoint>, widths: Vec<f64>) -> Self {
        let mut part_of_patch = Vec::new();
        let mut in_cells: HashMap<_, Vec<Side>> = HashMap::new();
        let patch_of = |s: &CloudPoint| {
            let cell = patch_cell(&s.point, widths[s.part]);
            let sides = in_cells.entry((s.part, cell)).or_default();
            if let Some(side) = sides.iter().find(|side| side.normal.dot(&s.normal) > SAME_SIDE) {
                return side.patch;
            }
            let patch = part_of_patch.len();
            sides.push(Side { normal: s.normal, patch });
            part_of_patch.push(s.part);
            patch
        };
        let patches = surfels.iter().map(patch_of).collect();
        Self { patches, part_of_patch, surfels, edges: Vec::new(), widths }
    }

    /// Cloud of every third surfel: enough to compare configurations.
    pub fn thinned(&self) -> Self {
        let kept = self.surfels.iter().copied().step_by(THINNING).collect();
        Self::in_patches(kept, self.widths.clone())
    }
}

/// A surfel projected into the image.
#[derive(Clone, Copy)]
pub struct Placed {
    /// Index of the surfel in the cloud.
    pub index: usize,
    /// Index of the part.
    pub part: usize,
    /// Place in the camera frame, metres.
    pub point: Point3<f64>,
    /// Unit normal in the camera frame.
    pub normal: Vector3<f64>,
    /// Pixel.
    pub pixel: (usize, usize),
    /// Cosine between the normal and the direction to the camera.
    pub cosine: f64,
}

/// Smallest depth that is compared, metres: no depth camera sees nearer.
pub const NEAREST_M: f64 = 0.3;
/// Smallest cosine between the normal of a surface and the direction to the camera at which it is compared: more
/// slanted surface has depth without a usable normal.
const LEAST_COSINE: f64 = 0.2;
/// Smallest share of a part's surfels that are too slanted to be compared for the part to be edge-on.
const EDGE_ON_SHARE: f64 = 0.9;
/// Side of a cell of the coarse depth buffer that detects self-occlusion, pixels.
const BUFFER_PX: usize = 4;

/// Coarse depth buffer of the region of the image that an object covers.
pub struct DepthBuffer {
    first: (usize, usize),
    columns: usize,
    parts: usize,
    /// Depth of the nearest surfel by cell and part, metres, in the cell or its left and right neighbours; infinite
    /// if there is none.
    nearest: Vec<f32>,
}

impl DepthBuffer {
    /// Depth buffer in which each surfel fills its cell and the cells to its left and right.
    pub fn of(placed: &[Placed]) -> Self {
        let (mut first, mut last) = ((usize::MAX, usize::MAX), (1, 1));
        let mut parts = 0;
        for p in placed {
            let (u, v) = cell_of(p.pixel);
            first = (first.0.min(u), first.1.min(v));
            last = (last.0.max(u), last.1.max(v));
            parts = parts.max(p.part + 1);
        }
        // A margin of one cell on each side, for the neighbours.
        let first = (first.0.min(last.0) - 1, first.1.min(last.1) - 1);
        let (columns, rows) = (last.0 + 2 - first.0, last.1 + 2 - first.1);
        let mut nearest = vec![f32::INFINITY; columns * rows * parts];
        for p in placed {
            let (u, v) = cell_of(p.pixel);
            let cell = (v - first.1) * columns + u - first.0;
            for cell in cell - 1..=cell + 1 {
                let nearest = &mut nearest[cell * parts + p.part];
                *nearest = smaller(*nearest, p.point.z as f32);
            }
        }
        Self { first, columns, parts, nearest }
    }

    /// Depth, metres, of the nearest surfel of `part` about a pixel, and of that of any other part; infinite if
    /// there is none.
    pub fn nearest(&self, pixel: (usize, usize), part: usize) -> (f64, f64) {
        let (mut own, mut other) = (f32::INFINITY, f32::INFINITY);
        let (u, v) = cell_of(pixel);
        let column = u.checked_sub(self.first.0).filter(|column| *column < self.columns);
        for row in v - 1..=v + 1 {
            let Some((row, column)) = row.checked_sub(self.first.1).zip(column) else { continue };
            let from = (row * self.columns + column) * self.parts;
            let by_part = self.nearest.get(from..from + self.parts).unwrap_or(&[]);
            for (owner, z) in by_part.iter().enumerate() {
                let nearest = if owner == part { &mut own } else { &mut other };
                *nearest = smaller(*nearest, *z);
            }
        }
        (f64::from(own), f64::from(other))
    }

    /// True if another part than `part` is before a place at depth `z`, metres, about a pixel, or close behind it.
    pub fn shows_another_part(&self, pixel: (usize, usize), part: usize, z: f64) -> bool {
        self.nearest(pixel, part).1 < z + BEHIND_M
    }
}

/// Largest distance behind a place, metres, of another part of the object that may be what is seen there.
const BEHIND_M: f64 = 0.03;

/// Cell of a pixel, counted from 1 so that each cell has neighbours.
fn cell_of(pixel: (usize, usize)) -> (usize, usize) {
    (pixel.0 / BUFFER_PX + 1, pixel.1 / BUFFER_PX + 1)
}

/// Surfels that the camera should see in a state. If two parts claim one place, only the nearer one is visible: what
/// is seen there is no evidence for the other.
pub fn visible(scene: &Scene, cloud: &Cloud, poses: &[Pose]) -> Vec<Placed> {
    let camera = &scene.frame.camera;
    let poses: Vec<_> = poses.iter().map(matrix_pose).collect();
    let mut placed = Vec::with_capacity(cloud.surfels.len());
    for (index, s) in cloud.surfels.iter().enumerate() {
        let pose = &poses[s.part];
        let point = pose * s.point;
        if point.z < NEAREST_M {
            continue;
        }
        let Some(pixel) = camera.project(&point).filter(|p| camera.sees(p, 2.0)) else { continue };
        let pixel = ((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize);
        let normal = pose * s.normal;
        let cosine = -normal.dot(&point.coords) / point.coords.norm();
        placed.push(Placed { index, part: s.part, point, normal, pixel, cosine });
    }
    let buffer = DepthBuffer::of(&placed);
    placed.retain(|p| {
        let slack = 0.03 + 0.02 * (1.0 - p.cosine.clamp(0.0, 1.0));
        let (own, other) = buffer.nearest(p.pixel, p.part);
        p.cosine > LEAST_COSINE && p.point.z <= own + slack && p.point.z <= other + 0.005
    });
    placed
}

/// For each part, true if it is seen edge-on, so that hardly any of its surface can be compared.
pub fn edge_on(cloud: &Cloud, poses: &[Pose]) -> Vec<bool> {
    let mut counts = vec![(0, 0); poses.len()];
    for s in &cloud.surfels {
        let (point, normal) = (poses[s.part] * s.point, poses[s.part] * s.normal);
        let cosine = normal.dot(&point.coords) / point.coords.norm();
        let (all, grazing) = &mut counts[s.part];
        *all += 1;
        *grazing += usize::from(cosine.abs() < LEAST_COSINE);
    }
    let is_edge_on =
        |(all, grazing): (usize, usize)| all > 0 && grazing as f64 >= EDGE_ON_SHARE * all as f64;
    counts.into_iter().map(is_edge_on).collect()
}

/// Edge of a part's surface, object frame at configuration 0, metres.
#[derive(Clone, Copy)]
pub struct KnownEdge {
    /// Index of the part.
    pub part: usize,
    /// A place on the surface of the part.
    pub surface: Point3<f64>,
    /// Unit normal at that place.
    pub normal: Vector3<f64>,
    /// A place in the tangent plane, just outside the surface, in free space.
    pub beyond: Point3<f64>,
    /// Smallest and largest configuration of the part's joint at which `beyond` is free space.
    pub configurations: [f64; 2],
}

/// Unpacks stored edges.
pub fn known_edges(edges: &[Edge]) -> Vec<KnownEdge> {
    let known = |e: &Edge| KnownEdge {
        part: usize::from(e.part),
        surface: e.surface.map(f64::from).into(),
        normal: e.normal.map(f64::from).into(),
        beyond: e.beyond.map(f64::from).into(),
        configurations: e.configurations.map(f64::from),
    };
    edges.iter().map(known).collect()
}

/// Side of a patch, metres: a piece of a part's surface with even illumination. Two planks of different paint are
/// two levels of lightness, and any two levels correlate: only variation within a patch distinguishes surfaces.
const PATCH_M: f64 = 0.1;
/// Mean number of surfels of a patch. An appearance holds at most 1200 surfels of a part: on a door of 2 square metres six
/// in a patch of the usual width, which are too few to correlate, so that a barn's door was not recognised at all.
const MEAN_IN_PATCH: f64 = 20.0;
/// Number of surfels of a part from which it is large rather than seen little.
const LARGE_PART: usize = 600;
/// Smallest cosine between normals of one patch: around a corner the illumination is another.
const SAME_SIDE: f64 = 0.7;

/// Width of the patches of each part, metres: wider than usual where the surfels of a large part are far apart.
fn patch_widths(surfels: &[CloudPoint]) -> Vec<f64> {
    let mut parts: Vec<(usize, HashSet<[i32; 3]>)> = Vec::new();
    for s in surfels {
        if parts.len() <= s.part {
            parts.resize_with(s.part + 1, Default::default);
        }
        parts[s.part].0 += 1;
        parts[s.part].1.insert(patch_cell(&s.point, PATCH_M));
    }
    let width = |(count, cells): &(usize, HashSet<_>)| {
        let wanted = (MEAN_IN_PATCH * cells.len() as f64 / *count as f64).sqrt();
        if *count >= LARGE_PART { PATCH_M * wanted.max(1.0) } else { PATCH_M }
    };
    parts.iter().map(width).collect()
}

fn patch_cell(point: &Point3<f64>, width: f64) -> [i32; 3] {
    [point.x, point.y, point.z].map(|x| (x / width).floor() as i32)
}

/// A patch and the normal of its first surfel.
struct Side {
    normal: Vector3<f64>,
    patch: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_sides_of_an_edge_are_two_patches() {
        let surfel = |normal| CloudPoint {
            part: 0,
            point: Point3::new(0.01, 0.01, 1.01),
            normal,
            lab: [50.0, 0.0, 0.0],
        };
        let slanted = Vector3::new(0.3, 0.0, -1.0).normalize();
        let cloud = Cloud::of([-Vector3::z(), Vector3::x(), slanted].map(surfel).into());
        assert_eq!(cloud.patches, [0, 1, 0]);
    }

    #[test]
    fn patches_of_a_large_part_are_wide_enough_to_hold_its_surfels() {
        let board = |side: f64, count: u32| {
            let surfel = |i: u32| {
                let (x, y) =
                    (f64::from(i) * 0.618_034 % 1.0, (f64::from(i) + 0.5) / f64::from(count));
                CloudPoint {
                    part: 0,
                    point: Point3::new(side * x, side * y, 1.05),
                    normal: -Vector3::z(),
                    lab: [50.0, 0.0, 0.0],
                }
            };
            Cloud::of((0..count).map(surfel).collect())
        };
        let mean = |cloud: &Cloud| cloud.surfels.len() / cloud.part_of_patch.len();
        assert_eq!(board(0.5, 1200).part_of_patch.len(), 25);
        let door = board(1.5, 1200);
        assert!((15..25).contains(&mean(&door)), "{}", mean(&door));
        assert_eq!(door.thinned().part_of_patch.len(), door.part_of_patch.len());
        assert_eq!(mean(&board(0.5, 100)), 4, "little was seen of it");
    }

    #[test]
    fn a_thin_part_is_edge_on_where_none_of_its_sides_faces_the_camera() {
        let side = |normal| {
            move |i| CloudPoint {
                part: 0,
                point: Point3::new(0.0, 0.01 * f64::from(i), 1.0),
                normal,
                lab: [50.0, 0.0, 0.0],
            }
        };
        let sides = (0..10).map(side(Vector3::x())).chain((0..10).map(side(-Vector3::x())));
        let rim = side(-Vector3::z())(0);
        let cloud = Cloud::of(sides.chain([rim]).collect());
        let beside = |x| [Pose::translation(x, 0.0, 0.0)];
        assert_eq!(edge_on(&cloud, &beside(0.0)), [true]);
        assert_eq!(edge_on(&cloud, &beside(0.5)), [false], "one side is seen");
        assert_eq!(edge_on(&Cloud::of(Vec::new()), &beside(0.0)), [false], "nothing is known");
    }

    #[test]
    fn a_surfel_behind_another_part_is_not_the_nearest_there() {
        let placed = |part, z| Placed {
            index: 0,
            part,
            point: Point3::new(0.0, 0.0, z),
            normal: -Vector3::z(),
            pixel: (100, 100),
            cosine: 1.0,
        };
        let buffer = DepthBuffer::of(&[placed(0, 1.5), placed(1, 1.25)]);
        assert_eq!(buffer.nearest((100, 100), 0), (1.5, 1.25));
        assert_eq!(buffer.nearest((100, 100), 1), (1.25, 1.5));
        assert_eq!(buffer.nearest((300, 100), 0), (f64::INFINITY, f64::INFINITY));
    }
}
