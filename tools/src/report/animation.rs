//! A short animation: small pictures that CSS shows one after the other.
//!
//! It needs no network and no script. It is bounded in bytes, pauses while the pointer is on it, and is
//! a still picture on paper and where the system is set to reduced motion.

use anyhow::anyhow;
use base64::Engine;
use linkage_driver::{ColorImage, jpeg};
use maud::{Markup, PreEscaped, html};

/// Largest number of pictures of an animation.
pub const MOST_FRAMES: usize = 24;
/// Width of a picture, pixels.
pub const WIDTH: i32 = 400;
/// Quality of pictures, of 100.
const JPEG_QUALITY: u8 = 72;
/// Largest size of all pictures of an animation together, bytes; where they are larger, every second
/// picture is left out.
const MOST_BYTES: usize = 500_000;
/// Time for which a picture is shown, seconds.
const FRAME_S: f64 = 0.16;

/// An animation. The picture with the number `still` is the one that is printed. Empty where there
/// are no pictures.
pub fn animation(frames: &[ColorImage], still: usize, caption: &str) -> anyhow::Result<Markup> {
    let pictures: Vec<Vec<u8>> = frames
        .iter()
        .map(|frame| {
            jpeg::encode(frame, JPEG_QUALITY)
                .map_err(|e| anyhow!("a picture of \"{caption}\" cannot be written as JPEG: {e}"))
        })
        .collect::<anyhow::Result<_>>()?;
    let chosen = within_size(&pictures, still);
    let Some(first) = frames.first() else { return Ok(html! {}) };
    let (width, height, count) = (first.width(), first.height(), chosen.len());
    // Each picture is visible for its share of the duration.
    let style = format!(
        "@keyframes frames{count}{{0%{{visibility:visible}}{:.3}%,100%{{visibility:hidden}}}}",
        100.0 / count as f64
    );
    let timing = format!("--frames:frames{count};--duration:{:.2}s", FRAME_S * count as f64);
    Ok(html! {
        figure {
            style { (PreEscaped(style)) }
            div.animation style=(timing) {
                @for (i, &number) in chosen.iter().enumerate() {
                    @let data = base64::engine::general_purpose::STANDARD.encode(&pictures[number]);
                    @let begin = format!("animation-delay:{:.2}s", FRAME_S * i as f64);
                    img.still[number == still] src={ "data:image/jpeg;base64," (data) }
                        width=(width) height=(height) style=(begin)
                        alt=(if number == still { caption } else { "" });
                }
            }
            figcaption { (caption) }
        }
    })
}

/// Numbers of pictures that together are at most [`MOST_BYTES`] large; the still one is always kept.
fn within_size(pictures: &[Vec<u8>], still: usize) -> Vec<usize> {
    let mut chosen: Vec<usize> = (0..pictures.len()).collect();
    let bytes = |chosen: &[usize]| chosen.iter().map(|&i| pictures[i].len()).sum::<usize>();
    while bytes(&chosen) > MOST_BYTES && chosen.len() > 1 {
        let before = chosen.len();
        let mut place = 0;
        chosen.retain(|&i| {
            place += 1;
            place % 2 == 1 || i == still
        });
        // The still one alone, where nothing else can be left out.
        if chosen.len() == before || (chosen.len() <= 2 && bytes(&chosen) > MOST_BYTES) {
            chosen.retain(|&i| i == still);
            break;
        }
    }
    chosen
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(shade: u8) -> ColorImage {
        ColorImage::new(16, 8, vec![shade; 16 * 8 * 3]).unwrap()
    }

    #[test]
    fn each_picture_has_its_time_and_one_is_the_still() {
        let frames = [frame(0), frame(100), frame(200)];
        let page = animation(&frames, 1, "a door opens").unwrap().into_string();
        assert_eq!(page.matches("<img").count(), 3);
        assert_eq!(page.matches("class=\"still\"").count(), 1);
        assert!(page.contains("alt=\"a door opens\""), "{page}");
        for begin in ["0.00s", "0.16s", "0.32s"] {
            assert!(page.contains(&format!("animation-delay:{begin}")), "{page}");
        }
    }

    #[test]
    fn large_pictures_are_thinned_until_they_fit_and_the_still_one_stays() {
        let sizes = |size: usize, count: usize| vec![vec![0; size]; count];
        assert_eq!(within_size(&sizes(100, 24), 5).len(), 24);
        let thinned = within_size(&sizes(60_000, 24), 5);
        assert!(thinned.contains(&5) && thinned.len() * 60_000 <= MOST_BYTES, "{thinned:?}");
        assert_eq!(within_size(&sizes(2 * MOST_BYTES, 3), 1), [1]);
        assert_eq!(within_size(&[], 0), [0_usize; 0]);
    }

    #[test]
    fn without_pictures_there_is_no_animation() {
        assert_eq!(animation(&[], 0, "nothing").unwrap().into_string(), "");
    }
}
