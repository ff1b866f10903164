//! Self-contained HTML pages, and the pictures in them.

use super::draw::{Canvas, PART_COLOURS};
use super::text::{describe, summary};
use base64::Engine;
use linkage_driver::{ColorImage, RgbdFrame, image_file};
use linkage_planner_bridge::Prediction;
use linkage_skill::Demonstration;
use linkage_skill::math::rigid::{Pose, pose_from_array};
use linkage_skill::object::appearance::Appearance;
use linkage_skill::object::model::{Joint, ObjectModel};
use linkage_skill::predict::moved_surface;
use linkage_skill::recognise::{Recognised, Recognition};
use linkage_skill::store::Library;
use nalgebra::{Point2, Point3, Vector3};
use plotters::prelude::*;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Outlines drawn of a motion manifold.
const MANIFOLD_STEPS: usize = 9;

/// A page about a demonstration.
pub fn demonstration_page(
    demonstration: &Demonstration,
    appearance: Option<&Appearance>,
) -> anyhow::Result<String> {
    let model = &demonstration.model;
    let mut body = format!("<h1>{}</h1>\n", escape(&model.object));
    body += &joint_table(model);
    let middle = middle_keyframe(demonstration);
    if let Some((index, frame)) = middle {
        body += &figure(
            "Features by part (blue: base)",
            &tracks_picture(demonstration, index, frame)?,
        )?;
        body += &figure(
            "Joint axes and motion manifold",
            &joints_picture(demonstration, index, frame)?,
        )?;
    }
    if let (Some((index, frame)), Some(appearance)) = (middle, appearance) {
        let picture = surface_picture(demonstration, appearance, index, frame)?;
        body += &figure("Surface kept for recognition, by part", &picture)?;
    }
    body += &format!(
        "<figure>{}<figcaption>Configuration over time</figcaption></figure>\n",
        configuration_plot(model)?
    );
    body += "<h2>Time</h2>\n<table><tr><th>stage</th><th>seconds</th></tr>\n";
    for (stage, time) in demonstration.times.iter() {
        let _ = writeln!(body, "<tr><td>{stage}</td><td>{:.2}</td></tr>", time.as_secs_f64());
    }
    body += "</table>\n";
    Ok(page(&format!("Linkage: {}", model.object), &body))
}

/// Writes a demonstration's pictures into a folder; their paths.
pub fn save_demonstration_pictures(
    demonstration: &Demonstration,
    dir: &Path,
) -> anyhow::Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    if let Some((index, frame)) = middle_keyframe(demonstration) {
        for (name, picture) in [
            ("tracks.png", tracks_picture(demonstration, index, frame)?),
            ("joints.png", joints_picture(demonstration, index, frame)?),
        ] {
            let path = dir.join(name);
            image_file::write_color(&path, &picture)?;
            written.push(path);
        }
    }
    let path = dir.join("configuration.svg");
    std::fs::write(&path, configuration_plot(&demonstration.model)?)?;
    written.push(path);
    Ok(written)
}

/// A page about a recognition.
pub fn recognition_page(
    frame: &RgbdFrame,
    recognition: &Recognition,
    library: &Library,
) -> anyhow::Result<String> {
    let mut canvas = Canvas::new(frame)?;
    for (i, m) in recognition.matches.iter().enumerate() {
        draw_recognised(&mut canvas, m, i)?;
    }
    let mut body = String::from("<h1>Recognition</h1>\n");
    let _ = writeln!(
        body,
        "<p>{} of {} known objects recognised.</p>",
        recognition.matches.len(),
        library.len()
    );
    for m in &recognition.matches {
        let _ = writeln!(body, "<p>{}</p>", escape(&describe(m)));
    }
    body += &figure("Joint axes as recognised", &canvas.finish()?)?;
    Ok(page("Linkage: recognition", &body))
}

/// Draws a prediction into the frame that it starts from.
pub fn save_prediction_picture(
    frame: &RgbdFrame,
    recognised: &Recognised,
    prediction: &Prediction,
    appearance: &Appearance,
    path: &Path,
) -> anyhow::Result<()> {
    let mut canvas = Canvas::new(frame)?;
    draw_recognised(&mut canvas, recognised, 0)?;
    for part in &prediction.parts {
        let poses: Vec<Pose> = part
            .poses
            .iter()
            .filter_map(|p| pose_from_array(&[p[1], p[2], p[3], p[4], p[5], p[6], p[7]]))
            .collect();
        let (Some(first), false) = (poses.first(), poses.is_empty()) else { continue };
        let stride = poses.len().div_ceil(MANIFOLD_STEPS).max(1);
        let motions: Vec<Pose> =
            poses.iter().step_by(stride).map(|p| p * first.inverse()).collect();
        if let Some(outline) = outline_of(frame, appearance, part.part, first)? {
            canvas.manifold(&outline, &motions, PART_COLOURS[part.part % PART_COLOURS.len()])?;
        }
    }
    canvas.save(path)
}

/// Outline of a part's surface, from what of it is seen.
fn outline_of(
    frame: &RgbdFrame,
    appearance: &Appearance,
    part: usize,
    camera_from_part: &Pose,
) -> anyhow::Result<Option<Vec<Point3<f64>>>> {
    let features: Vec<Point2<f64>> = appearance
        .surfels
        .iter()
        .filter(|s| usize::from(s.part) == part)
        .filter_map(|s| {
            let place = camera_from_part * Point3::from(Vector3::from(s.point).map(f64::from));
            let pixel = frame.camera.project(&place)?;
            let z = f64::from(frame.depth.at_nearest(pixel.x, pixel.y)?);
            ((z - place.z).abs() < 0.04).then_some(pixel)
        })
        .collect();
    lifted_surface(frame, &features)
}

fn lifted_surface(
    frame: &RgbdFrame,
    features: &[Point2<f64>],
) -> anyhow::Result<Option<Vec<Point3<f64>>>> {
    Ok(moved_surface(frame, features)?.map(|outline| {
        let mut depths: Vec<f64> = features
            .iter()
            .filter_map(|f| frame.depth.at_nearest(f.x, f.y))
            .map(f64::from)
            .collect();
        depths.sort_by(f64::total_cmp);
        let middle = depths.get(depths.len() / 2).copied().unwrap_or(1.0);
        outline
            .iter()
            .map(|p| {
                // An outline runs along edges, where depth belongs to either side.
                let z = frame
                    .depth
                    .at_nearest(p.x, p.y)
                    .map(f64::from)
                    .filter(|z| (z - middle).abs() < 0.4)
                    .unwrap_or(middle);
                frame.camera.back_project(p.x, p.y, z)
            })
            .collect()
    }))
}

fn draw_recognised(canvas: &mut Canvas, m: &Recognised, index: usize) -> anyhow::Result<()> {
    for (j, joint) in m.joints.iter().enumerate() {
        canvas.axis(&joint.geometry(), PART_COLOURS[(j + 1) % PART_COLOURS.len()])?;
    }
    canvas.text(index as i32, describe(m).trim())?;
    Ok(())
}

/// The keyframe in which the parts have moved most, nearly half way through.
fn middle_keyframe(demonstration: &Demonstration) -> Option<(usize, &RgbdFrame)> {
    let moved = |index: usize| {
        demonstration.camera_from_part.iter().skip(1).filter_map(|t| t[index].as_ref()).count()
    };
    let frames: Vec<(usize, &RgbdFrame)> = demonstration.keyframes.iter().collect();
    let middle = frames.len() / 2;
    frames
        .iter()
        .enumerate()
        .max_by_key(|(i, (index, _))| (moved(*index), std::cmp::Reverse(i.abs_diff(middle))))
        .map(|(_, f)| *f)
}

fn tracks_picture(
    demonstration: &Demonstration,
    index: usize,
    frame: &RgbdFrame,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    for (track, part) in demonstration.tracks.tracks.iter().zip(&demonstration.track_parts) {
        let Some(seen) = track.at(index) else { continue };
        let at = Point2::new(f64::from(seen.pixel.x), f64::from(seen.pixel.y));
        match part {
            Some(p) => {
                canvas.dot(at, if *p == 0 { 1 } else { 3 }, PART_COLOURS[p % PART_COLOURS.len()])?
            }
            None => canvas.dot(at, 2, [160, 160, 160])?,
        }
    }
    canvas.finish()
}

fn surface_picture(
    demonstration: &Demonstration,
    appearance: &Appearance,
    index: usize,
    frame: &RgbdFrame,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    for s in &appearance.surfels {
        let part = usize::from(s.part);
        let Some(pose) = demonstration.camera_from_part[part][index] else { continue };
        let place = pose * Point3::from(Vector3::from(s.point).map(f64::from));
        let normal = pose * Vector3::from(s.normal).map(f64::from);
        if normal.dot(&place.coords) > 0.0 {
            continue;
        }
        if let Some(pixel) = frame.camera.project(&place) {
            canvas.dot(pixel, 2, PART_COLOURS[part % PART_COLOURS.len()])?;
        }
    }
    canvas.finish()
}

fn joints_picture(
    demonstration: &Demonstration,
    index: usize,
    frame: &RgbdFrame,
) -> anyhow::Result<ColorImage> {
    let mut canvas = Canvas::new(frame)?;
    let model = &demonstration.model;
    for joint in &model.joints {
        let Some(camera_from_parent) = demonstration.camera_from_part[joint.parent][index] else {
            continue;
        };
        let colour = PART_COLOURS[joint.child % PART_COLOURS.len()];
        let line = joint.geometry().transformed(&camera_from_parent);
        canvas.axis(&line, colour)?;
        let features: Vec<Point2<f64>> = demonstration
            .tracks
            .tracks
            .iter()
            .zip(&demonstration.track_parts)
            .filter(|(_, p)| **p == Some(joint.child))
            .filter_map(|(t, _)| t.at(index))
            .map(|o| Point2::new(f64::from(o.pixel.x), f64::from(o.pixel.y)))
            .collect();
        if let Some(outline) = lifted_surface(frame, &features)? {
            let present = present_configuration(joint, demonstration.frame_utimes[index]);
            let motions: Vec<Pose> = (0..MANIFOLD_STEPS)
                .map(|i| {
                    let q = joint.range[0]
                        + (joint.range[1] - joint.range[0]) * i as f64
                            / (MANIFOLD_STEPS - 1) as f64;
                    line.motion(q - present)
                })
                .collect();
            canvas.manifold(&outline, &motions, colour)?;
        }
    }
    for (i, text) in summary(model).lines().enumerate() {
        canvas.text(i as i32, text)?;
    }
    canvas.finish()
}

fn present_configuration(joint: &Joint, utime: i64) -> f64 {
    let t = utime as f64 * 1e-6;
    joint
        .configuration
        .iter()
        .min_by(|a, b| (a[0] - t).abs().total_cmp(&(b[0] - t).abs()))
        .map_or(0.0, |c| c[1])
}

fn configuration_plot(model: &ObjectModel) -> anyhow::Result<String> {
    let points: Vec<[f64; 2]> = model.joints.iter().flat_map(|j| j.configuration.clone()).collect();
    let start = points.iter().map(|p| p[0]).fold(f64::INFINITY, f64::min);
    let bounds = |k: usize| {
        let low = points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
        let high = points.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max);
        if low < high { (low, high) } else { (low.min(0.0), low.min(0.0) + 1.0) }
    };
    let mut svg = String::new();
    if points.is_empty() {
        return Ok("<svg xmlns=\"http://www.w3.org/2000/svg\"/>".to_owned());
    }
    {
        let area = SVGBackend::with_string(&mut svg, (640, 300)).into_drawing_area();
        area.fill(&WHITE)?;
        let ((t0, t1), (q0, q1)) = (bounds(0), bounds(1));
        let pad = 0.05 * (q1 - q0);
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(30)
            .y_label_area_size(50)
            .build_cartesian_2d(0.0..(t1 - t0), (q0 - pad)..(q1 + pad))?;
        chart.configure_mesh().x_desc("seconds").y_desc("rad or m").draw()?;
        for joint in &model.joints {
            let [r, g, b] = PART_COLOURS[joint.child % PART_COLOURS.len()];
            let colour = RGBColor(r, g, b);
            chart.draw_series(LineSeries::new(
                joint.configuration.iter().map(|c| (c[0] - start, c[1])),
                &colour,
            ))?;
        }
        area.present()?;
    }
    Ok(svg)
}

fn joint_table(model: &ObjectModel) -> String {
    let mut table = String::from(
        "<table><tr><th>joint</th><th>type</th><th>on</th><th>moves</th><th>range</th><th>axis</th><th>origin / m</th><th>rmse / mm</th></tr>\n",
    );
    for j in &model.joints {
        let vector = |v: [f64; 3]| format!("{:.3}, {:.3}, {:.3}", v[0], v[1], v[2]);
        let _ = writeln!(
            table,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{:.3} to {:.3} {}</td><td>{}</td><td>{}</td><td>{:.1}</td></tr>",
            escape(&j.name),
            j.kind.name(),
            escape(&model.parts[j.parent].name),
            escape(&model.parts[j.child].name),
            j.range[0],
            j.range[1],
            j.kind.unit(),
            vector(j.axis),
            vector(j.origin),
            1000.0 * j.position_rmse
        );
    }
    if model.joints.is_empty() {
        table += "<tr><td colspan=\"8\">nothing articulated moves</td></tr>\n";
    }
    table + "</table>\n"
}

fn figure(caption: &str, picture: &ColorImage) -> anyhow::Result<String> {
    let dir = tempfile::tempdir()?;
    let path = dir.path().join("figure.png");
    image_file::write_color(&path, picture)?;
    let data = base64::engine::general_purpose::STANDARD.encode(std::fs::read(&path)?);
    Ok(format!(
        "<figure><img src=\"data:image/png;base64,{data}\" alt=\"{0}\"><figcaption>{0}</figcaption></figure>\n",
        escape(caption)
    ))
}

fn page(title: &str, body: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>{}</title>\n\
         <style>body{{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem}}\
         table{{border-collapse:collapse}}td,th{{border:1px solid #ccc;padding:.2rem .6rem;text-align:left}}\
         figure{{margin:1.5rem 0}}img,svg{{max-width:100%}}</style></head>\n<body>\n{body}</body></html>\n",
        escape(title)
    )
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
