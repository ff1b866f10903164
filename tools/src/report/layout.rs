//! The frame of a page, and what pages are put together from: figures, keys of colours, tables.
//!
//! A page is one file that needs nothing else: style and pictures are within it.

use super::draw::{Rgb, part_colour};
use anyhow::anyhow;
use base64::Engine;
use linkage_driver::{ColorImage, jpeg};
use linkage_skill::learn::StageTimes;
use maud::{DOCTYPE, Markup, PreEscaped, html};

const STYLE: &str = include_str!("style.css");
/// Quality of pictures, of 100.
const JPEG_QUALITY: u8 = 88;

/// A whole page.
pub fn page(title: &str, body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) }
                // Without one, browsers ask for a file beside the page.
                link rel="icon" href="data:,";
                style { (PreEscaped(STYLE)) }
            }
            body { main { (body) } }
        }
    };
    page.into_string()
}

/// A picture with what it shows.
pub fn picture(picture: &ColorImage, caption: &str) -> anyhow::Result<Markup> {
    let bytes = jpeg::encode(picture, JPEG_QUALITY)
        .map_err(|e| anyhow!("the picture \"{caption}\" cannot be written as JPEG: {e}"))?;
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    let (width, height) = (picture.width(), picture.height());
    Ok(html! {
        figure {
            img src={ "data:image/jpeg;base64," (data) } width=(width) height=(height) alt=(caption);
            figcaption { (caption) }
        }
    })
}

/// A chart with what it shows; `svg` is trusted.
pub fn chart(svg: &str, caption: &str) -> Markup {
    html! {
        figure.chart role="img" aria-label=(caption) {
            (PreEscaped(svg))
            figcaption { (caption) }
        }
    }
}

/// Which colour is which part.
pub fn keys<'n>(parts: impl IntoIterator<Item = (usize, &'n str)>) -> Markup {
    html! {
        ul.keys {
            @for (part, name) in parts {
                li { span.key style=(part_style(part)) {} (name) }
            }
        }
    }
}

/// The style of what belongs to a part: its colour.
pub fn part_style(part: usize) -> String {
    let [r, g, b]: Rgb = part_colour(part);
    format!("--part:rgb({r},{g},{b})")
}

/// A table of quantities and values.
pub fn facts(caption: &str, rows: &[(&str, String)]) -> Markup {
    html! {
        table {
            caption { (caption) }
            @for (quantity, value) in rows {
                tr { th scope="row" { (quantity) } td { (value) } }
            }
        }
    }
}

/// How long each stage took, with its name in words.
pub fn times(times: &StageTimes, in_words: impl Fn(&'static str) -> &'static str) -> Markup {
    html! {
        details {
            summary { "Where the time went" }
            table {
                tr { th { "stage" } th { "seconds" } }
                @for (stage, time) in times.iter() {
                    tr { td { (in_words(stage)) } td { (format!("{:.2}", time.as_secs_f64())) } }
                }
            }
        }
    }
}

/// Three numbers of a vector.
pub fn vector(v: [f64; 3]) -> String {
    format!("{:.3}, {:.3}, {:.3}", v[0], v[1], v[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_from_outside_is_text_and_no_markup() {
        let hostile = "<script>alert(\"x\")</script>";
        let page = page(hostile, &keys([(1, hostile)]));
        assert!(!page.contains("<script>") && page.contains("&lt;script&gt;"), "{page}");
    }

    #[test]
    fn a_page_names_no_other_file() {
        let page = page("x", &facts("x", &[("y", "z".to_owned())]));
        for outside in ["http:", "https:", "url(", "@import", "src=\"/", "<script"] {
            assert!(!page.contains(outside), "{outside}");
        }
    }
}
