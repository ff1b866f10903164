//! Surface nets: the triangles of the zero of a sampled function.
//!
//! Each cell in which the sign changes has one vertex, at the mean of the crossings of its edges;
//! each edge of the samples' grid that crosses zero has a quadrilateral between the four cells around
//! it. Vertices are shared by construction, so that the surface is closed where the samples' border
//! lies outside. (fast-surface-nets does the same, but brings a second version of its vector library;
//! mcubes leaves the vertices of neighbouring cells apart.)

use super::fused_surface::Samples;
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// Vertices and triangles, counterclockwise seen from where the function is positive.
pub fn surface_nets(samples: &Samples) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let [nx, ny, nz] = samples.counts;
    let mut vertices = Vec::new();
    let mut of_cell: HashMap<usize, u32> = HashMap::new();
    for z in 0..nz.saturating_sub(1) {
        for y in 0..ny.saturating_sub(1) {
            for x in 0..nx.saturating_sub(1) {
                if let Some(at) = samples.crossing_of([x, y, z]) {
                    of_cell.insert(samples.index([x, y, z]), vertices.len() as u32);
                    vertices.push(at);
                }
            }
        }
    }
    let mut triangles = Vec::new();
    for z in 1..nz.saturating_sub(1) {
        for y in 1..ny.saturating_sub(1) {
            for x in 1..nx.saturating_sub(1) {
                for axis in 0..3 {
                    let around = samples.quadrilateral([x, y, z], axis);
                    let corners = around.map(|cells| cells.map(|cell| of_cell.get(&cell).copied()));
                    if let Some([Some(a), Some(b), Some(c), Some(d)]) = corners {
                        triangles.extend([[a, b, c], [a, c, d]]);
                    }
                }
            }
        }
    }
    (vertices, triangles)
}

impl Samples {
    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.counts[1] + y) * self.counts[0] + x
    }

    /// The mean of the places where a cell's edges cross zero; `None` where none does.
    fn crossing_of(&self, cell: [usize; 3]) -> Option<Point3<f64>> {
        let corner = |i: usize| [0, 1, 2].map(|k| i >> k & 1);
        let value = |i: usize| {
            let c = corner(i);
            f64::from(self.values[self.index([0, 1, 2].map(|k| cell[k] + c[k]))])
        };
        let values: [f64; 8] = std::array::from_fn(value);
        let inside = values.iter().filter(|v| **v < 0.0).count();
        if inside == 0 || inside == 8 {
            return None;
        }
        let (mut sum, mut count) = (Vector3::zeros(), 0.0);
        for i in 0..8 {
            for axis in (0..3).filter(|k| i >> k & 1 == 0) {
                let (a, b) = (values[i], values[i | 1 << axis]);
                if (a < 0.0) != (b < 0.0) {
                    let mut at = Vector3::from(corner(i).map(|c| c as f64));
                    at[axis] = a / (a - b);
                    sum += at;
                    count += 1.0;
                }
            }
        }
        let at = Vector3::from(cell.map(|c| c as f64)) + sum / count;
        Some(Point3::from(self.origin + at * self.step_m))
    }

    /// The cells around the edge that leads from a sample along an axis, in the order of the
    /// quadrilateral; `None` where the edge does not cross zero.
    fn quadrilateral(&self, at: [usize; 3], axis: usize) -> Option<[usize; 4]> {
        let mut next = at;
        next[axis] += 1;
        let here = self.values[self.index(at)] < 0.0;
        if here == (self.values[self.index(next)] < 0.0) {
            return None;
        }
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let cell = |back_u: usize, back_v: usize| {
            let mut cell = at;
            cell[u] -= back_u;
            cell[v] -= back_v;
            self.index(cell)
        };
        let around = [cell(1, 1), cell(0, 1), cell(0, 0), cell(1, 0)];
        Some(if here { around } else { [around[3], around[2], around[1], around[0]] })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_has_its_volume_and_no_open_edge() {
        let (n, step_m) = (40, 0.01);
        let value = |i: usize| {
            let at = Vector3::new(i % n, i / n % n, i / (n * n)).map(|k| k as f64 * step_m);
            ((at - Vector3::repeat(0.2)).norm() - 0.15) as f32
        };
        let values = (0..n * n * n).map(value).collect();
        let samples = Samples { counts: [n; 3], step_m, origin: Vector3::zeros(), values };
        let (vertices, triangles) = surface_nets(&samples);
        let at = |i: u32| vertices[i as usize].coords;
        let volume: f64 =
            triangles.iter().map(|[a, b, c]| at(*a).dot(&at(*b).cross(&at(*c))) / 6.0).sum();
        let wanted = 4.0 / 3.0 * std::f64::consts::PI * 0.15_f64.powi(3);
        assert!((volume / wanted - 1.0).abs() < 0.02, "{volume} {wanted}");
        let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
        for [a, b, c] in triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((from.min(to), from.max(to))).or_default() +=
                    if from < to { 1 } else { -1 };
            }
        }
        assert!(edges.values().all(|n| *n == 0));
    }
}
