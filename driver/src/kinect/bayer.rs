//! The colour camera's mosaic: green and red in even rows, blue and green in odd ones.

/// Colours of a mosaic by the mean of the nearest pixels of each; RGB, top row first. `None`
/// when the mosaic does not hold `width * height` bytes or is too small.
pub fn demosaic(mosaic: &[u8], width: usize, height: usize) -> Option<Vec<u8>> {
    if width < 2 || height < 2 || mosaic.len() != width.checked_mul(height)? {
        return None;
    }
    // Mirrored about the border, which keeps the pattern.
    let inside = |x: isize, side: usize| -> usize {
        let last = side as isize - 1;
        (if x < 0 {
            -x
        } else if x > last {
            2 * last - x
        } else {
            x
        }) as usize
    };
    let at = |u: isize, v: isize| u16::from(mosaic[inside(v, height) * width + inside(u, width)]);
    let mut rgb = Vec::with_capacity(mosaic.len() * 3);
    for v in 0..height as isize {
        for u in 0..width as isize {
            let here = at(u, v);
            let across = (at(u - 1, v) + at(u + 1, v)) / 2;
            let along = (at(u, v - 1) + at(u, v + 1)) / 2;
            let beside = (at(u - 1, v) + at(u + 1, v) + at(u, v - 1) + at(u, v + 1)) / 4;
            let corners =
                (at(u - 1, v - 1) + at(u + 1, v - 1) + at(u - 1, v + 1) + at(u + 1, v + 1)) / 4;
            let (r, g, b) = match (v % 2, u % 2) {
                (0, 0) => (across, here, along),
                (0, _) => (here, beside, corners),
                (_, 0) => (corners, beside, here),
                _ => (along, here, across),
            };
            rgb.extend([r, g, b].map(|c| c as u8));
        }
    }
    Some(rgb)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plain_colour_comes_back() {
        let (width, height) = (6, 4);
        let colour = [200_u8, 120, 40];
        let mosaic: Vec<u8> = (0..width * height)
            .map(|i| match (i / width % 2, i % width % 2) {
                (0, 1) => colour[0],
                (1, 0) => colour[2],
                _ => colour[1],
            })
            .collect();
        let rgb = demosaic(&mosaic, width, height).unwrap();
        assert!(rgb.chunks_exact(3).all(|p| p == colour), "{rgb:?}");
        assert_eq!(demosaic(&mosaic, width, height + 1), None);
    }
}
