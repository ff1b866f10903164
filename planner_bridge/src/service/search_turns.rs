//! Which search comes next while something is looked for: by features in the newest frame, or by shape too.
//!
//! In: the frames in time order. Out: for each search, its number among those of its kind, and the frames of a camera
//! that stands still if shape is searched.
//!
//! What has no features is found by its shape alone. That takes 0.1 to 0.4 s for each object, and needs depth of
//! little noise, so that it is searched in several frames of a camera that stands still. Afterwards there is as
//! much time for searches by features, which take less and also find what moves.

use linkage_driver::RgbdFrame;
use linkage_skill::recognise::StillFrames;
use std::time::{Duration, Instant};

/// Smallest number of frames in which shape is searched: the noise of depth has fallen to a third then.
const LEAST_STILL: usize = 10;

/// Searches so far, and what the next one may look at.
#[derive(Default)]
pub struct SearchTurns {
    /// Latest frames of a camera that stands still.
    still: StillFrames,
    by_features: usize,
    by_shape: usize,
    /// The search that runs.
    running: Option<Running>,
    /// How long the last search by shape took, and when it ended.
    last_by_shape: Option<(Duration, Instant)>,
}

struct Running {
    since: Instant,
    is_by_shape: bool,
}

impl SearchTurns {
    /// Takes the next frame.
    pub fn frame(&mut self, frame: &RgbdFrame) {
        self.still.push(frame.clone());
    }

    /// Begins the next search: its number among those of its kind, and the frames in which shape is searched too.
    pub fn begin(&mut self) -> (usize, Option<StillFrames>) {
        let is_by_shape =
            self.by_features > 0 && self.still.len() >= LEAST_STILL && self.is_rested();
        self.running = Some(Running { since: Instant::now(), is_by_shape });
        if is_by_shape {
            (self.by_shape, Some(std::mem::take(&mut self.still)))
        } else {
            (self.by_features, None)
        }
    }

    /// The search that runs has ended, and what is wanted was not found.
    pub fn end(&mut self) {
        let Some(Running { since, is_by_shape }) = self.running.take() else { return };
        if is_by_shape {
            self.by_shape += 1;
            self.last_by_shape = Some((since.elapsed(), Instant::now()));
        } else {
            self.by_features += 1;
        }
    }

    /// Number of searches that have ended.
    #[cfg(test)]
    pub fn ended(&self) -> usize {
        self.by_features + self.by_shape
    }

    /// True if since the last search by shape as much time has passed as it took.
    fn is_rested(&self) -> bool {
        self.last_by_shape.is_none_or(|(took, ended)| ended.elapsed() >= took)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};
    use std::sync::Arc;

    /// A tiled wall 2 m away, its tiles shifted by some pixels.
    fn wall(shift_px: usize) -> RgbdFrame {
        let (width, height) = (320, 240);
        let camera = PinholeCamera { width, height, ..PinholeCamera::kinect() };
        let tile =
            |i: usize| 90 + 80 * ((((i % width) + shift_px) / 24 + i / width / 24) % 2) as u8;
        let rgb = (0..width * height).flat_map(|i| [tile(i); 3]).collect();
        let color = ColorImage::new(width, height, rgb).unwrap();
        let depth = DepthImage::from_metres(width, height, vec![2.0; width * height]).unwrap();
        RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()
    }

    /// Runs the next search: its number, and the frames in which shape is searched.
    fn searched(turns: &mut SearchTurns) -> (usize, Option<usize>) {
        let (turn, still) = turns.begin();
        turns.end();
        (turn, still.map(|frames| frames.len()))
    }

    #[test]
    fn features_are_searched_first_and_shape_once_the_camera_has_stood_still() {
        let mut turns = SearchTurns::default();
        (0..LEAST_STILL).for_each(|_| turns.frame(&wall(0)));
        assert_eq!(searched(&mut turns), (0, None));
        assert_eq!(searched(&mut turns), (0, Some(LEAST_STILL)));
        assert_eq!(searched(&mut turns), (1, None), "other frames are needed now");
        assert_eq!(turns.ended(), 3);
    }

    #[test]
    fn shape_is_not_searched_while_the_camera_moves() {
        let mut turns = SearchTurns::default();
        for tile in 0..3 * LEAST_STILL {
            turns.frame(&wall(24 * tile));
            assert_eq!(searched(&mut turns).1, None);
        }
    }

    #[test]
    fn after_a_search_by_shape_features_have_as_much_time() {
        let mut turns = SearchTurns { by_features: 1, ..SearchTurns::default() };
        let has_stood_still = |turns: &mut SearchTurns| {
            (0..LEAST_STILL).for_each(|_| turns.frame(&wall(0)));
            searched(turns).1.is_some()
        };
        assert!(has_stood_still(&mut turns));
        turns.last_by_shape = Some((Duration::from_secs(60), Instant::now()));
        assert!(!has_stood_still(&mut turns));
        turns.last_by_shape = Some((Duration::ZERO, Instant::now()));
        assert!(has_stood_still(&mut turns));
    }
}
