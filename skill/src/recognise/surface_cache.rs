//! The surface at any pixel of a frame, computed on first use, because states that are compared query the same
//! pixels repeatedly.

use linkage_frames::depth::{NormalMap, SurfacePatch};
use std::sync::OnceLock;

/// Side of a tile, pixels.
const TILE_PX: usize = 16;

/// Cached surfaces of a tile; `None` where there is no surface.
type Tile = [OnceLock<Option<SurfacePatch>>; TILE_PX * TILE_PX];

/// Surfaces of one frame. Memory is allocated only for tiles that are queried.
pub struct Surfaces {
    normals: NormalMap,
    width: usize,
    height: usize,
    tiles: Vec<OnceLock<Box<Tile>>>,
}

impl Surfaces {
    /// Empty cache for a frame of this size, pixels.
    pub fn new(normals: NormalMap, width: usize, height: usize) -> Self {
        let count = width.div_ceil(TILE_PX) * height.div_ceil(TILE_PX);
        Self { normals, width, height, tiles: (0..count).map(|_| OnceLock::new()).collect() }
    }

    /// Surface at a pixel, camera frame; `None` outside the image or without a surface.
    pub fn at(&self, u: usize, v: usize) -> Option<SurfacePatch> {
        if u >= self.width || v >= self.height {
            return None;
        }
        let tile = (v / TILE_PX) * self.width.div_ceil(TILE_PX) + u / TILE_PX;
        let tile = self.tiles[tile]
            .get_or_init(|| Box::new([const { OnceLock::new() }; TILE_PX * TILE_PX]));
        *tile[(v % TILE_PX) * TILE_PX + u % TILE_PX].get_or_init(|| self.normals.at(u, v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_data::{board, seen};

    #[test]
    fn what_is_remembered_is_what_the_picture_shows() {
        let frame = seen(3, board(0.3, 1.5, 2.5));
        let normals = || NormalMap::new(&frame.depth, &frame.camera);
        let (width, height) = (frame.camera.width, frame.camera.height);
        let surfaces = Surfaces::new(normals(), width, height);
        let fresh = normals();
        for v in (0..height + 4).step_by(3) {
            for u in (0..width + 4).step_by(3) {
                assert_eq!(surfaces.at(u, v), fresh.at(u, v));
                assert_eq!(surfaces.at(u, v), fresh.at(u, v));
            }
        }
        assert!(surfaces.at(width / 2, height / 2).is_some());
        assert!(surfaces.at(width, 0).is_none() && surfaces.at(0, height).is_none());
    }
}
