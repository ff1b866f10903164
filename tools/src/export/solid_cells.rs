//! What is solid of a part that carries others: cells of its box, joined to few boxes.
//!
//! The box is divided by planes: evenly, and where that which passes through it ends. A cell is solid
//! if it lies behind the surface that was seen (its generalised winding number is positive) and if
//! nothing passes through it.

use super::cuboid::{Cuboid, UNSEEN_SIDE_M};
use super::overlap::{CLEARANCE_M, is_overlapping};
use nalgebra::{Point3, Vector3};

/// Even divisions of each side.
const DIVISIONS: usize = 14;
/// Most planes across a side.
const MOST_PLANES: usize = 40;
/// Planes keep this distance, metres.
const LEAST_CELL_M: f64 = 0.001;
/// With less surface the whole box is taken for solid.
const LEAST_SURFACE: usize = 50;
/// Boxes thinner than this are left out, metres.
const THINNEST_M: f64 = 0.004;
/// How far a part of which nothing else is left is moved to keep its box, metres.
const LARGEST_SHIFT_M: f64 = 0.05;
/// Most boxes of a part.
const MOST_BOXES: usize = 24;

/// Cells of a box, in the box's own axes.
pub struct SolidCells {
    /// Places of the planes across each axis, in order.
    planes: [Vec<f64>; 3],
    solid: Vec<bool>,
}

/// Least and greatest place along the three axes.
type Extent = (Vector3<f64>, Vector3<f64>);

impl SolidCells {
    /// Of a part's box; `surface` are places and normals, `passing` the boxes that each carried part
    /// takes, from one end of its range to the other.
    pub fn new(
        shape: &Cuboid,
        surface: &[(Vector3<f64>, Vector3<f64>)],
        passing: &[Vec<Cuboid>],
    ) -> Self {
        let planes = planes(shape, passing);
        let count: usize = planes.iter().map(|p| p.len() - 1).product();
        let mut cells = Self { planes, solid: vec![true; count] };
        if surface.len() >= LEAST_SURFACE {
            cells.keep_what_lies_behind(surface, shape);
        }
        for taken in passing.iter().flatten() {
            cells.cut(taken, shape);
        }
        cells
    }

    fn counts(&self) -> [usize; 3] {
        [0, 1, 2].map(|k| self.planes[k].len() - 1)
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.counts();
        (z * ny + y) * nx + x
    }

    fn all(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let [nx, ny, nz] = self.counts();
        (0..nx * ny * nz).map(move |i| [i % nx, i / nx % ny, i / (nx * ny)])
    }

    /// The corners of the cells from `low` to `high`, both included.
    fn extent(&self, low: [usize; 3], high: [usize; 3]) -> Extent {
        let at = |cell: [usize; 3], further: usize| {
            Vector3::from_fn(|k, _| self.planes[k][cell[k] + further])
        };
        (at(low, 0), at(high, 1))
    }

    fn keep_what_lies_behind(&mut self, surface: &[(Vector3<f64>, Vector3<f64>)], shape: &Cuboid) {
        for cell in self.all() {
            let (low, high) = self.extent(cell, cell);
            let at = shape.rotation * (0.5 * (low + high));
            let winding = surface.iter().map(|(place, normal)| {
                let way = place - at;
                way.dot(normal) / way.norm().max(1e-3).powi(3)
            });
            let index = self.index(cell);
            self.solid[index] = winding.sum::<f64>() > 0.0;
        }
    }

    fn cut(&mut self, taken: &Cuboid, shape: &Cuboid) {
        let (least, greatest) = extent_along(taken, shape);
        let mut ranges = [(0, 0); 3];
        for k in 0..3 {
            let planes = &self.planes[k];
            let first = planes.partition_point(|p| *p < least[k] - CLEARANCE_M);
            let last = planes.partition_point(|p| *p < greatest[k] + CLEARANCE_M);
            ranges[k] = (first.saturating_sub(1), last.min(planes.len() - 1));
        }
        for z in ranges[2].0..ranges[2].1 {
            for y in ranges[1].0..ranges[1].1 {
                for x in ranges[0].0..ranges[0].1 {
                    let index = self.index([x, y, z]);
                    let (low, high) = self.extent([x, y, z], [x, y, z]);
                    let cell = exactly(low, high, shape);
                    self.solid[index] = self.solid[index] && !is_overlapping(taken, &cell);
                }
            }
        }
    }

    /// The solid cells as boxes; a small box beside what passes where none is left.
    pub fn into_boxes(mut self, shape: &Cuboid, passing: &[Vec<Cuboid>]) -> Vec<Cuboid> {
        let mut boxes = Vec::new();
        for first in self.all() {
            if self.solid[self.index(first)] {
                let last = self.grown(first);
                self.take(first, last);
                let (low, high) = self.extent(first, last);
                boxes.push(exactly(low, high, shape));
            }
        }
        boxes.retain(|b| b.size.min() >= THINNEST_M);
        boxes.sort_by(|a, b| b.volume().total_cmp(&a.volume()));
        boxes.truncate(MOST_BOXES);
        if boxes.is_empty() { vec![beside(shape, passing)] } else { boxes }
    }

    /// The last cell of the block of solid cells that begins here, of the greatest volume that growing
    /// along the axes one after the other makes.
    fn grown(&self, first: [usize; 3]) -> [usize; 3] {
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let grown = orders.map(|order| {
            let mut last = first;
            for k in order {
                while last[k] + 1 < self.counts()[k] && self.is_solid_slice(first, last, k) {
                    last[k] += 1;
                }
            }
            let (low, high) = self.extent(first, last);
            ((high - low).product(), last)
        });
        grown.into_iter().fold((0.0, first), |a, b| if b.0 > a.0 { b } else { a }).1
    }

    /// True where the block from `first` to `last` can grow by a slice along an axis.
    fn is_solid_slice(&self, first: [usize; 3], last: [usize; 3], axis: usize) -> bool {
        let (mut from, mut to) = (first, last);
        from[axis] = last[axis] + 1;
        to[axis] = last[axis] + 1;
        block(from, to).all(|cell| self.solid[self.index(cell)])
    }

    fn take(&mut self, first: [usize; 3], last: [usize; 3]) {
        for cell in block(first, last) {
            let index = self.index(cell);
            self.solid[index] = false;
        }
    }
}

/// All cells of a block, both ends included.
fn block(from: [usize; 3], to: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (from[2]..=to[2]).flat_map(move |z| {
        (from[1]..=to[1]).flat_map(move |y| (from[0]..=to[0]).map(move |x| [x, y, z]))
    })
}

/// The box between two corners in the axes of another, however thin.
fn exactly(low: Vector3<f64>, high: Vector3<f64>, shape: &Cuboid) -> Cuboid {
    let center = Point3::from(shape.rotation * (0.5 * (low + high)));
    Cuboid { center, rotation: shape.rotation, size: high - low }
}

/// Extent of a box along the axes of another.
fn extent_along(of: &Cuboid, shape: &Cuboid) -> Extent {
    let corners = of.corners().map(|c| shape.rotation.inverse() * c.coords);
    let low = corners.iter().skip(1).fold(corners[0], |a, b| a.inf(b));
    (low, corners.iter().fold(corners[0], |a, b| a.sup(b)))
}

/// Extent of several boxes.
fn extent_of_all<'b>(boxes: impl Iterator<Item = &'b Cuboid>, shape: &Cuboid) -> Option<Extent> {
    let extents = boxes.map(|b| extent_along(b, shape));
    extents.reduce(|a, b| (a.0.inf(&b.0), a.1.sup(&b.1)))
}

/// Planes across the axes of a box: even ones, and those where what passes ends.
fn planes(shape: &Cuboid, passing: &[Vec<Cuboid>]) -> [Vec<f64>; 3] {
    let (low, high) = shape.corners_along_sides();
    let mut ends: Vec<Extent> = Vec::new();
    for part in passing {
        let at_ends = [part.first(), part.last()].into_iter().flatten();
        ends.extend(at_ends.map(|b| extent_along(b, shape)));
        ends.extend(extent_of_all(part.iter(), shape));
    }
    std::array::from_fn(|k| {
        let beyond = ends.iter().flat_map(|(l, h)| [l[k] - CLEARANCE_M, h[k] + CLEARANCE_M]);
        let inside = beyond.filter(|p| *p > low[k] + LEAST_CELL_M && *p < high[k] - LEAST_CELL_M);
        let mut planes: Vec<f64> = inside.take(MOST_PLANES - DIVISIONS - 2).collect();
        let exact = planes.clone();
        let step = (high[k] - low[k]) / DIVISIONS as f64;
        // An even plane beside an exact one would only make thin cells.
        let even = (1..DIVISIONS).map(|i| low[k] + step * i as f64);
        planes.extend(even.filter(|p| exact.iter().all(|e| (e - p).abs() > 0.4 * step)));
        planes.extend([low[k], high[k]]);
        planes.sort_by(f64::total_cmp);
        planes.dedup_by(|b, a| *b - *a < LEAST_CELL_M && *b < high[k]);
        planes
    })
}

/// What stands for a part of which nothing else is left: its whole box where a small shift makes room,
/// as for the thin base under a laptop's lid; else a small box below all that passes.
fn beside(shape: &Cuboid, passing: &[Vec<Cuboid>]) -> Cuboid {
    let (own_low, own_high) = shape.corners_along_sides();
    let all = extent_of_all(passing.iter().flatten(), shape);
    let (low, high) = all.unwrap_or((own_low, own_high));
    let shifts = (0..3).flat_map(|k| {
        let down = low[k] - CLEARANCE_M - own_high[k];
        let up = high[k] + CLEARANCE_M - own_low[k];
        [(k, down.min(0.0)), (k, up.max(0.0))]
    });
    let least = shifts.min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    if let Some((k, shift)) = least.filter(|(_, shift)| shift.abs() <= LARGEST_SHIFT_M) {
        let mut way = Vector3::zeros();
        way[k] = shift;
        return Cuboid { center: shape.center + shape.rotation * way, ..shape.clone() };
    }
    let mut center = 0.5 * (low + high);
    center.z = low.z - 0.5 * UNSEEN_SIDE_M - CLEARANCE_M;
    Cuboid::unseen(Point3::from(shape.rotation * center), shape.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    fn block_between(low: [f64; 3], high: [f64; 3]) -> Cuboid {
        Cuboid::between(low.into(), high.into(), UnitQuaternion::identity())
    }

    #[test]
    fn a_drawer_leaves_walls_round_its_way() {
        let chest = block_between([0.0, 0.0, 0.0], [0.4, 0.5, 0.6]);
        let passing = (0..9).map(|i| {
            let out = 0.04 * f64::from(i);
            block_between([out, 0.03, 0.2], [0.4 + out, 0.47, 0.4])
        });
        let passing = [passing.collect::<Vec<_>>()];
        let boxes = SolidCells::new(&chest, &[], &passing).into_boxes(&chest, &passing);
        assert!(boxes.len() <= 4, "{} boxes", boxes.len());
        let volume: f64 = boxes.iter().map(Cuboid::volume).sum();
        let wanted = 0.4 * 0.5 * 0.6 - 0.4 * 0.444 * 0.204;
        assert!((volume - wanted).abs() < 1e-3, "{volume} {wanted}");
        let touching = boxes.iter().any(|b| passing[0].iter().any(|p| is_overlapping(p, b)));
        assert!(!touching);
    }

    #[test]
    fn what_lies_before_the_surface_is_not_solid() {
        let corner = block_between([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]);
        // A floor at z = 0.1 and a wall at x = 0.2, seen from above and before.
        let floor = (0..400).map(|i| {
            let (x, y) = (0.2 + 0.04 * f64::from(i / 20), 0.05 * f64::from(i % 20));
            (Vector3::new(x, y, 0.1), Vector3::z())
        });
        let wall = (0..400).map(|i| {
            let (z, y) = (0.1 + 0.045 * f64::from(i / 20), 0.05 * f64::from(i % 20));
            (Vector3::new(0.2, y, z), Vector3::x())
        });
        let surface: Vec<_> = floor.chain(wall).collect();
        let boxes = SolidCells::new(&corner, &surface, &[]).into_boxes(&corner, &[]);
        let volume: f64 = boxes.iter().map(Cuboid::volume).sum();
        assert!((0.2..0.4).contains(&volume), "{volume} of 0.28");
    }

    #[test]
    fn a_part_of_which_nothing_is_left_is_small_and_lies_beside() {
        let plate = block_between([0.0, 0.0, 0.0], [0.01, 0.3, 0.3]);
        let passing = [vec![block_between([-0.1, -0.1, -0.1], [0.5, 0.5, 0.5])]];
        let boxes = SolidCells::new(&plate, &[], &passing).into_boxes(&plate, &passing);
        assert_eq!(boxes.len(), 1);
        assert!(!is_overlapping(&boxes[0], &passing[0][0]));
    }

    #[test]
    fn a_thin_base_under_a_lid_keeps_its_size() {
        let base = block_between([0.0, 0.0, 0.0], [0.3, 0.2, 0.015]);
        let passing = [vec![
            block_between([0.0, 0.0, 0.0], [0.3, 0.2, 0.02]),
            block_between([-0.01, 0.0, 0.0], [0.01, 0.2, 0.3]),
        ]];
        let boxes = SolidCells::new(&base, &[], &passing).into_boxes(&base, &passing);
        assert!(boxes.len() == 1 && (boxes[0].size - base.size).norm() < 1e-9);
        assert!(passing[0].iter().all(|p| !is_overlapping(p, &boxes[0])));
    }
}
