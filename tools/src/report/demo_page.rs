//! The page of `linkage demo`: what was demonstrated, how it was recognised, how it will move. Each
//! section links to the page with the details. The same is also made as one picture.

use super::draw::{Canvas, side_by_side};
use super::film_strip::film_strip;
use super::{animation, encountered, layout, learned, predicted};
use linkage_driver::{ColorImage, RgbdFrame};
use linkage_planner_bridge::Prediction;
use linkage_skill::Demonstration;
use linkage_skill::object::StoredObject;
use linkage_skill::recognise::Recognised;
use maud::{Markup, html};

/// Width of a section in the picture, pixels.
const PANEL_PX: i32 = 400;

/// What the page shows.
#[derive(Clone, Copy)]
pub struct DemoPage<'s> {
    pub demonstration: &'s Demonstration,
    /// What was learned from it.
    pub object: &'s StoredObject,
    /// The frame in which it was recognised.
    pub frame: &'s RgbdFrame,
    pub recognised: &'s Recognised,
    pub prediction: &'s Prediction,
}

/// Relative links to the pages with the details.
#[derive(Clone, Copy)]
pub struct DetailLinks<'s> {
    pub learned: &'s str,
    pub recognised: &'s str,
    pub predicted: &'s str,
}

impl DemoPage<'_> {
    /// The page as HTML. `proof`: sentences about its errors, and about what was published.
    pub fn html(&self, links: &DetailLinks, proof: &[String]) -> anyhow::Result<String> {
        let Self { demonstration, object, frame, recognised, prediction } = *self;
        let name = &object.model.object;
        let met = encountered::overlaid(frame, recognised, Some(object))?;
        let body = html! {
            h1 { "From one demonstration to a motion: " (name) }
            h2 { "1. A person moves it once" }
            (learned::in_words(demonstration, Some(&object.appearance)))
            (learned::animation(demonstration, Some(&object.appearance))?)
            (more(links.learned, "What was refused, the motion over time, the numbers"))
            h2 { "2. It is met again, from elsewhere" }
            (encountered::in_words(recognised))
            (layout::picture(&met, "Lines are axes; dots are the learned surface where it was recognised")?)
            (more(links.recognised, "How sure that is, the numbers"))
            h2 { "3. How it will move" }
            (predicted::in_words_of(prediction))
            (predicted::animation(frame, recognised, object, prediction)?)
            (more(links.predicted, "Speeds, accelerations, the way of each part"))
            h2 { "4. How right that was" }
            ul { @for sentence in proof { li { (sentence) } } }
        };
        Ok(layout::page(&format!("Linkage: {name}, the whole way"), &body))
    }

    /// The sections side by side.
    pub fn picture(&self) -> anyhow::Result<ColorImage> {
        let Self { demonstration, object, frame, recognised, prediction } = *self;
        let appearance = &object.appearance;
        let seen = film_strip(demonstration, Some(appearance), animation::MOST_FRAMES, PANEL_PX)?;
        let seen = seen.into_iter().max_by(|a, b| a.opened.total_cmp(&b.opened));
        let met = encountered::overlaid(frame, recognised, Some(object))?;
        let path = predicted::path_picture(frame, recognised, prediction, object)?;
        let panels = seen.map(|s| s.picture).into_iter().chain([met, path]);
        let titles = ["1  learn", "2  recognise", "3  predict"];
        let panels = panels.zip(titles).map(|(picture, title)| panel(picture, title));
        side_by_side(&panels.collect::<anyhow::Result<Vec<_>>>()?)
    }
}

/// A link to a page beside this one.
fn more(page: &str, what: &str) -> Markup {
    html! { p.note { a href=(page) { (what) } "." } }
}

/// A picture of a section, with its title.
fn panel(picture: ColorImage, title: &str) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::of(&picture)?;
    canvas.shrink_to(PANEL_PX)?;
    canvas.title(title)?;
    canvas.finish()
}
