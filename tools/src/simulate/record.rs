//! Writes a simulated recording: pictures, lists, camera, labels, truth.

use super::film::{Film, RATE, START, Take};
use super::render::{Backdrop, View, expose};
use super::world::{Scene, Solid};
use super::{sensor, tags};
use crate::truth::Truth;
use anyhow::Context;
use linkage_driver::{ColorImage, image_file};
use rayon::prelude::*;
use std::fmt::Write;
use std::path::Path;

/// Exposure of colour, seconds.
const EXPOSURE: f64 = 0.016;
/// Instants of the exposure that are rendered.
const INSTANTS: usize = 4;
/// Depth comes this much after colour, seconds.
const DEPTH_DELAY: f64 = 0.004;
/// Frames between label pictures.
const LABEL_EVERY: usize = 10;
/// Renders a scene into `dir`, with AprilTags on its parts on request; `progress` is called
/// after each frame.
///
/// # Errors
/// Names the file that cannot be written.
pub fn record(
    scene: &Scene,
    take: Take,
    seed: u64,
    dir: &Path,
    with_tags: bool,
    progress: impl Fn() + Sync,
) -> anyhow::Result<Truth> {
    let plain = Film::new(scene, take, seed);
    let tagged = if with_tags { Some(tags::attach(&plain)?) } else { None };
    let film = tagged.as_ref().map_or(plain, |(scene, _)| Film::new(scene, take, seed));
    let frames = take.frames(scene);
    for folder in ["rgb", "depth", "labels"] {
        let path = dir.join(folder);
        std::fs::create_dir_all(&path).with_context(|| path.display().to_string())?;
    }
    let (mut rgb_list, mut depth_list) =
        (String::from("# timestamp filename\n"), String::from("# timestamp filename\n"));
    let backdrop = backdrop(&film);
    let names: Vec<(String, String)> = (0..frames)
        .into_par_iter()
        .map(|i| {
            let names = write_frame(&film, backdrop.as_ref(), dir, i, seed);
            progress();
            names
        })
        .collect::<anyhow::Result<_>>()?;
    for (i, (rgb, depth)) in names.into_iter().enumerate() {
        let t = i as f64 / RATE;
        let _ = writeln!(rgb_list, "{:.6} {rgb}", START + t);
        let _ = writeln!(depth_list, "{:.6} {depth}", START + t + DEPTH_DELAY);
    }
    let truth = film.truth(frames);
    let write = |name: &str, text: String| {
        let path = dir.join(name);
        std::fs::write(&path, text).with_context(|| path.display().to_string())
    };
    write("rgb.txt", rgb_list)?;
    write("depth.txt", depth_list)?;
    write("camera.toml", toml::to_string(&film.camera)?)?;
    if let Some((_, places)) = &tagged {
        write(crate::tags::FILE, toml::to_string(places)?)?;
    }
    write("truth.json", serde_json::to_string(&truth)?)?;
    Ok(truth)
}

/// What is the same in all frames of a film; `None` where all of it may change.
fn backdrop(film: &Film) -> Option<Backdrop> {
    let still = film.still();
    let all = film.solids_at(0.0, &[]).into_iter().enumerate();
    let placed = all.filter(|(number, _)| still.contains(number));
    let view = View::new(&film.camera, &film.camera_from_world(0.0), placed);
    (!still.is_empty()).then(|| Backdrop::new(&view, &film.light))
}

/// What the camera sees at a time, without what stands still.
fn view<'f>(film: &'f Film, t: f64, person: &'f [Solid]) -> View<'f> {
    let still = film.still();
    let all = film.solids_at(t, person).into_iter().enumerate();
    let moving = all.filter(|(number, _)| !still.contains(number));
    View::new(&film.camera, &film.camera_from_world(t), moving)
}

/// Writes the colour and depth of one frame; returns the names of both files.
fn write_frame(
    film: &Film,
    backdrop: Option<&Backdrop>,
    dir: &Path,
    index: usize,
    seed: u64,
) -> anyhow::Result<(String, String)> {
    let t = index as f64 / RATE;
    let mut noise = sensor::noise_of(seed, index);
    let (width, height) = (film.camera.width, film.camera.height);
    let instants: Vec<f64> =
        (0..INSTANTS).map(|k| t + EXPOSURE * k as f64 / INSTANTS as f64).collect();
    let people: Vec<Vec<Solid>> = instants.iter().map(|&t| film.person_at(t)).collect();
    let views: Vec<View> =
        instants.iter().zip(&people).map(|(&t, person)| view(film, t, person)).collect();
    let rgb = sensor::colour(&expose(&views, &film.light, backdrop), &mut noise);
    let rgb_name = format!("rgb/{:.6}.png", START + t);
    image_file::write_color(&dir.join(&rgb_name), &ColorImage::new(width, height, rgb)?)?;

    let then = t + DEPTH_DELAY;
    let person = film.person_at(then);
    let surfaces = view(film, then, &person).surfaces(backdrop);
    let raw = sensor::depth(&surfaces, width, film.camera.depth_units_per_metre, &mut noise);
    let depth_name = format!("depth/{:.6}.png", START + then);
    image_file::write_depth(&dir.join(&depth_name), width, height, &raw)?;
    if index.is_multiple_of(LABEL_EVERY) {
        let labels: Vec<u8> = surfaces.iter().map(|s| s.map_or(0, |s| s.label)).collect();
        let path = dir.join(format!("labels/{:.6}.png", START + t));
        image_file::write_labels(&path, width, height, &labels)?;
    }
    Ok((rgb_name, depth_name))
}
