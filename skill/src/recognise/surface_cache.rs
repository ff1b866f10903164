//! The surface at any pixel of a picture, worked out when it is first asked for: states that are
//! compared ask for the same pixels again and again.

use linkage_frames::depth::{NormalMap, SurfacePatch};
use std::sync::OnceLock;

/// Side of a tile, pixels.
const TILE_PX: usize = 16;

/// Pixels of a tile; `None` where there is no surface.
type Tile = [OnceLock<Option<SurfacePatch>>; TILE_PX * TILE_PX];

/// Surfaces of one picture. Memory is taken for the tiles that are asked about.
pub struct Surfaces {
    normals: NormalMap,
    width: usize,
    height: usize,
    tiles: Vec<OnceLock<Box<Tile>>>,
}

impl Surfaces {
    /// Of a picture of this size.
    pub fn new(normals: NormalMap, width: usize, height: usize) -> Self {
        let count = width.div_ceil(TILE_PX) * height.div_ceil(TILE_PX);
        Self { normals, width, height, tiles: (0..count).map(|_| OnceLock::new()).collect() }
    }

    /// The surface at a pixel.
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
