//! What is looked at: things that were demonstrated, seen from elsewhere; the same shapes with
//! another surface, the same surfaces with another shape, and other things of the same kinds.

use crate::console::Progress;
use crate::outcome::Outcome;
use crate::simulate::{
    Scene, Shot, Surfaces, Take, TextureClass, add_common_clutter, instances, paint, record,
    repainted, reproportioned, scene,
};
use anyhow::anyhow;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;

/// Things that are demonstrated.
pub const THINGS: [&str; 15] = [
    "door",
    "drawer",
    "two_drawers",
    "fridge",
    "microwave",
    "laptop",
    "sliding_door",
    "cabinet",
    "office_chair",
    "lid_box",
    "printer",
    "scanner",
    "screen",
    "monitor",
    "bicycle",
];
/// Turns from the demonstration's viewpoint, degrees, to either side.
const TURNS: [f64; 5] = [10.0, 22.0, 34.0, 44.0, 57.0];
/// First seed of a draw: of its demonstrations' rooms.
fn home(draw: u64) -> u64 {
    draw.wrapping_mul(1000).wrapping_add(6000)
}

/// What a still shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Shows {
    /// A thing that was demonstrated.
    Known,
    /// Its shape with another surface.
    Repainted,
    /// Its surface with another shape.
    Reproportioned,
    /// Another thing of the kind.
    Other,
}

/// One still.
pub struct Still {
    /// Folder of its recording.
    pub name: String,
    /// What it shows.
    pub shows: Shows,
    /// The thing.
    pub thing: String,
    /// How it is filmed.
    pub shot: Shot,
    /// Texture of a thing at home; `None` with speckles.
    pub texture: Option<TextureClass>,
    seed: u64,
}

/// All stills of a draw of rooms and shots, in a fixed order. Paint keeps a thing's colour, so that what is repainted
/// with surfaces of a home is the same thing: it is left out.
pub fn all(draw: u64, surfaces: Surfaces) -> Vec<Still> {
    let mut stills = Vec::new();
    let mut add = |shows, thing: &str, tag: &str, turn: f64| {
        let seed = home(draw).wrapping_add(100 + stills.len() as u64);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let side = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let shot = Shot {
            turn_deg: side * turn,
            lift_deg: rng.random_range(-4.0..10.0),
            roll_deg: if rng.random_bool(0.3) { rng.random_range(-30.0..30.0) } else { 0.0 },
            distance: rng.random_range(0.9..1.2),
            light: rng.random_range(0.65..1.2),
            open: rng.random_range(0.0..1.0),
            occluded: rng.random_bool(0.25),
        };
        let name = format!("{thing}_{tag}");
        let texture = surfaces.texture(number_of(thing).unwrap_or(seed));
        stills.push(Still { name, shows, thing: thing.to_owned(), shot, texture, seed });
    };
    for thing in THINGS {
        for turn in TURNS {
            add(Shows::Known, thing, &format!("at{turn}"), turn);
        }
        add(Shows::Repainted, thing, "repainted", 12.0);
        add(Shows::Reproportioned, thing, "reproportioned", 12.0);
    }
    for other in instances::names() {
        add(Shows::Other, &other, "other", 15.0);
    }
    stills.retain(|still| surfaces == Surfaces::Speckled || still.shows != Shows::Repainted);
    stills
}

/// Number of a thing that is demonstrated.
fn number_of(thing: &str) -> Option<u64> {
    THINGS.iter().position(|t| *t == thing).map(|number| number as u64)
}

/// Renders a thing's demonstration, unless it is there.
pub fn demonstration(
    thing: &str,
    surfaces: Surfaces,
    draw: u64,
    dir: &Path,
    quiet: bool,
) -> Outcome {
    let number = number_of(thing).unwrap_or(0);
    let seed = home(draw).wrapping_add(number);
    let texture = surfaces.texture(number);
    render(|| scene(thing, seed), texture, Take::Demonstration, seed, dir, quiet)
}

impl Still {
    /// Renders it, unless it is there.
    pub fn render(&self, dir: &Path, quiet: bool) -> Outcome {
        let staged = || match self.shows {
            Shows::Known | Shows::Other => scene(&self.thing, self.seed),
            Shows::Repainted => repainted(&self.thing, self.seed),
            Shows::Reproportioned => reproportioned(&self.thing, self.seed),
        };
        render(staged, self.texture, Take::Still(self.shot), self.seed, dir, quiet)
    }
}

fn render(
    staged: impl FnOnce() -> Option<Scene>,
    texture: Option<TextureClass>,
    take: Take,
    seed: u64,
    dir: &Path,
    quiet: bool,
) -> Outcome {
    // The truth is written last: with it the recording is whole.
    if dir.join("truth.json").is_file() {
        return Ok(());
    }
    let mut staged = staged().ok_or_else(|| anyhow!("{}: no such scene", dir.display()))?;
    add_common_clutter(&mut staged, seed);
    paint(&mut staged, texture, seed);
    let total = take.frames(&staged);
    let progress = Progress::new("rendering", Some(total), quiet);
    record(&staged, take, seed, dir, false, || progress.step())?;
    progress.finish(&format!("{total} frames in {}", dir.display()));
    Ok(())
}
