//! Whether a camera stands where it stood: most edges in the picture are where they were, whoever
//! walks through it and whatever opens.

use super::scene::Scene;

/// Distance between the pixels that are compared.
const GRID_PX: usize = 6;
/// Pixels to either side between which lightness is differenced.
const REACH_PX: f64 = 2.0;
/// Difference of lightness, of 100, from which a pixel lies on an edge: one that moved by a pixel
/// shows it there.
const EDGE: f64 = 8.0;
/// Change of lightness at an edge that light and noise explain.
const SAME: f64 = 3.5;
/// Edge pixels below which a picture tells nothing.
const LEAST_EDGES: usize = 40;
/// Share of the edges that must be unchanged; people and what they move may hide the others.
const LEAST_SHARE: f64 = 0.6;

/// The edges of a frame.
pub struct EdgeView {
    /// Pixel and lightness there.
    edges: Vec<(f64, f64, f64)>,
}

impl EdgeView {
    /// Of a frame.
    pub fn of(scene: &Scene) -> Self {
        let size = (scene.frame.color.width(), scene.frame.color.height());
        Self::of_lightness(size, |u, v| scene.lab.lightness(u, v))
    }

    /// Of a picture of some columns and rows, by its lightness (0 to 100) at a column and a row.
    pub fn of_lightness(
        (width, height): (usize, usize),
        at: impl Fn(f64, f64) -> Option<f64>,
    ) -> Self {
        let grid = |length: usize| (GRID_PX..length.saturating_sub(GRID_PX)).step_by(GRID_PX);
        let edge = |u: usize, v: usize| {
            let (u, v) = (u as f64, v as f64);
            let across = at(u + REACH_PX, v)? - at(u - REACH_PX, v)?;
            let down = at(u, v + REACH_PX)? - at(u, v - REACH_PX)?;
            (across.abs().max(down.abs()) > EDGE).then_some((u, v, at(u, v)?))
        };
        let rows = grid(height).flat_map(|v| grid(width).map(move |u| (u, v)));
        Self { edges: rows.filter_map(|(u, v)| edge(u, v)).collect() }
    }

    /// The camera stands where it stood then, as far as this frame tells.
    pub fn is_still(&self, scene: &Scene) -> bool {
        self.is_still_in(|u, v| scene.lab.lightness(u, v))
    }

    /// The same by the lightness of a picture of the same size.
    pub fn is_still_in(&self, at: impl Fn(f64, f64) -> Option<f64>) -> bool {
        let same = |&&(u, v, lightness): &&(f64, f64, f64)| {
            at(u, v).is_some_and(|now| (now - lightness).abs() < SAME)
        };
        let unchanged = self.edges.iter().filter(same).count();
        self.edges.len() >= LEAST_EDGES && unchanged as f64 >= LEAST_SHARE * self.edges.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::seen;
    use linkage_frames::{ColorImage, RgbdFrame};

    /// A room of tiles, seen by a camera that is turned by some pixels, with a grey person before
    /// its left part.
    fn room(shift_px: usize, person_px: usize) -> Scene {
        let frame = seen(0, |_, _| 1.5);
        let (width, height) = (frame.camera.width, frame.camera.height);
        let grey = |i: usize| {
            let (u, v) = (i % width, i / width);
            let tile = ((u + shift_px) / 24 + v / 24) % 2;
            if u < person_px { 128 } else { 90 + 80 * tile as u8 }
        };
        let color = (0..width * height).flat_map(|i| [grey(i); 3]).collect();
        let color = ColorImage::new(width, height, color).unwrap();
        Scene::plain(&RgbdFrame { color, ..frame }).unwrap()
    }

    #[test]
    fn a_camera_that_stands_is_still_though_a_person_walks_by() {
        let before = EdgeView::of(&room(0, 0));
        assert!(before.is_still(&room(0, 0)));
        let width = room(0, 0).frame.camera.width;
        assert!(before.is_still(&room(0, width / 4)));
        assert!(!before.is_still(&room(0, 3 * width / 4)));
    }

    #[test]
    fn a_camera_that_turned_by_two_pixels_is_not() {
        let before = EdgeView::of(&room(0, 0));
        assert!(!before.is_still(&room(2, 0)));
        assert!(!before.is_still(&room(13, 0)));
    }

    #[test]
    fn a_plain_wall_tells_nothing() {
        let wall = Scene::plain(&seen(0, |_, _| 1.5)).unwrap();
        assert!(!EdgeView::of(&wall).is_still(&wall));
    }
}
