//! Test whether a camera has not moved: most intensity edges are where they were, even if a person walks by or a
//! part is opened.
//!
//! In: lightness (0 to 100) of two images of one size.
//! Out: true or false.

use super::scene::Scene;

/// Distance between compared pixels, pixels.
const GRID_PX: usize = 6;
/// Distance to either side over which lightness is differenced, pixels.
const REACH_PX: f64 = 2.0;
/// Smallest difference of lightness, of 100, at which a pixel lies on an edge; a shift of that edge by one pixel is
/// noticed.
const EDGE: f64 = 8.0;
/// Largest change of lightness, of 100, at an edge that light and noise explain.
const SAME: f64 = 3.5;
/// Smallest number of edge pixels; with fewer no camera counts as still.
const LEAST_EDGES: usize = 40;
/// Smallest share of the edges that must be unchanged; people and what they move may occlude the others.
const LEAST_SHARE: f64 = 0.6;

/// Edge pixels of an image.
pub struct EdgeView {
    /// Column, row and lightness of each edge pixel.
    edges: Vec<(f64, f64, f64)>,
}

impl EdgeView {
    /// Edges of a frame.
    pub fn of(scene: &Scene) -> Self {
        let size = (scene.frame.color.width(), scene.frame.color.height());
        Self::of_lightness(size, |u, v| scene.lab.lightness(u, v))
    }

    /// Edges of an image of some columns and rows, by its lightness (0 to 100) at a column and a row.
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

    /// True if the camera has not moved since these edges were seen, as far as this frame shows.
    pub fn is_still(&self, scene: &Scene) -> bool {
        self.is_still_in(|u, v| scene.lab.lightness(u, v))
    }

    /// True if the camera has not moved since these edges were seen, by the lightness of an image of equal size.
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
