//! AprilTags on the parts of a scene: where the camera sees them best and longest.

use super::film::Film;
use super::texture::Texture;
use super::world::{Form, Material, Scene, Solid};
use crate::tags::{TagPlace, TagPlaces, bit_pattern};
use linkage_skill::Pose;
use nalgebra::{Point3, Rotation3, UnitQuaternion, Vector3};
use parry3d::math::Vector as PVector;
use parry3d::shape::Cuboid;
use std::sync::Arc;

/// Largest tag, metres.
const MAX_SIZE: f64 = 0.2;
/// Smallest worth sticking on.
const MIN_SIZE: f64 = 0.03;
/// Share of a side's shorter edge that a tag with its white rim may take.
const SHARE: f64 = 0.9;
/// Share of a side's area that it may take: nothing is learned from a tag, and enough must be left to
/// learn from.
const SHARE_OF_AREA: f64 = 0.25;
/// Sizes that are tried, as shares of the largest that has room.
const SIZES: [f64; 3] = [1.0, 0.75, 0.5];
/// Spots along a side of the paper that must all be seen.
const GRID: usize = 19;
/// Instants at which its visibility is asked.
const INSTANTS: usize = 12;
/// Thickness of the paper.
const THICKNESS: f64 = 0.001;
/// Side of the paper, in tags: the white rim helps detection.
const PAPER_SIDE: f64 = 1.25;

/// A place for a tag.
struct Candidate {
    part: usize,
    size: f64,
    part_from_tag: Pose,
}

/// The scene with a tag on each part that has room for one, and where they are.
///
/// # Errors
/// The error of the vision library.
pub fn attach(film: &Film) -> anyhow::Result<(Scene, TagPlaces)> {
    let mut scene = film.scene.clone();
    let mut places = TagPlaces::default();
    for part in 0..film.scene.parts.len() {
        let best = candidates(film.scene, part)
            .into_iter()
            .map(|c| (visibility(film, &c), c))
            .filter(|(v, _)| *v > 0.0)
            .max_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, candidate)) = best else { continue };
        let id = part as u32;
        let label = scene.parts[part].solids[0].label;
        scene.parts[part].solids.push(paper(&candidate, id, label)?);
        places.tag.push(TagPlace {
            id,
            size_m: candidate.size,
            part: scene.parts[part].name.clone(),
        });
    }
    Ok((scene, places))
}

/// Places on the sides of a part's boxes: the middle and half way to each corner.
fn candidates(scene: &Scene, part: usize) -> Vec<Candidate> {
    let mut found = Vec::new();
    for solid in &scene.parts[part].solids {
        let Form::Box(b) = &solid.form else { continue };
        let half = [b.half_extents.x, b.half_extents.y, b.half_extents.z].map(f64::from);
        for side in 0..3 {
            let (x, y) = ((side + 1) % 3, (side + 2) % 3);
            let by_edge = 2.0 * half[x].min(half[y]) * SHARE;
            let by_area = (4.0 * half[x] * half[y] * SHARE_OF_AREA).sqrt();
            let room = by_edge.min(by_area) / PAPER_SIDE;
            if room < MIN_SIZE {
                continue;
            }
            for size in SIZES.map(|share| share * room.min(MAX_SIZE)) {
                if size >= MIN_SIZE {
                    found.extend(on_side(part, solid, &half, side, size));
                }
            }
        }
    }
    found
}

/// Places of one size on both faces across an axis of a box: the middle and the corners.
fn on_side(part: usize, solid: &Solid, half: &[f64; 3], side: usize, size: f64) -> Vec<Candidate> {
    let (x, y) = ((side + 1) % 3, (side + 2) % 3);
    let reach = |k: usize| (half[k] - 0.5 * PAPER_SIDE * size).max(0.0);
    let mut found = Vec::new();
    for out in [-1.0, 1.0] {
        for (dx, dy) in [(0.0, 0.0), (-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let mut place = Vector3::zeros();
            place[side] = out * (half[side] + 0.5 * THICKNESS);
            place[x] = dx * reach(x);
            place[y] = dy * reach(y);
            let (mut right, mut normal) = (Vector3::zeros(), Vector3::zeros());
            right[x] = 1.0;
            normal[side] = out;
            let up = normal.cross(&right);
            let turn = Rotation3::from_basis_unchecked(&[right, up, normal]);
            let pose = Pose::from_parts(place.into(), UnitQuaternion::from_rotation_matrix(&turn));
            found.push(Candidate { part, size, part_from_tag: solid.body_from_solid * pose });
        }
    }
    found
}

/// Pixels that the tag covers, foreshortened, summed over the instants in which nothing stands
/// before any of it.
fn visibility(film: &Film, candidate: &Candidate) -> f64 {
    (0..INSTANTS)
        .map(|i| {
            let t = film.scene.duration * (i as f64 + 0.5) / INSTANTS as f64;
            let person = film.person_at(t);
            let solids = film.solids_at(t, &person);
            let camera_from_world = film.camera_from_world(t);
            let part = film.scene.world_from_part(&film.configurations(t))[candidate.part];
            let camera_from_tag = camera_from_world * part * candidate.part_from_tag;
            let step = PAPER_SIDE * candidate.size / (GRID - 1) as f64;
            let spot = |k: usize| (k as f64 - 0.5 * (GRID - 1) as f64) * step;
            let spots: Vec<Point3<f64>> = (0..GRID * GRID)
                .map(|i| camera_from_tag * Point3::new(spot(i % GRID), spot(i / GRID), THICKNESS))
                .collect();
            let clear = |p: &Point3<f64>| {
                film.camera.project(p).is_some_and(|px| film.camera.sees(&px, 8.0))
                    && solids.iter().all(|(solid, world_from_body)| {
                        let camera_from_solid =
                            camera_from_world * world_from_body * solid.body_from_solid;
                        let solid_from_camera = camera_from_solid.inverse();
                        let eye = (solid_from_camera * Point3::origin()).coords;
                        let ray = solid_from_camera * p.coords;
                        solid.cast(&eye, &ray, 1.0 - 0.002 / p.coords.norm() as f32).is_none()
                    })
            };
            if !spots.iter().all(clear) {
                return 0.0;
            }
            let middle = camera_from_tag.translation.vector;
            let facing = -(camera_from_tag * Vector3::z()).dot(&middle.normalize());
            let pixels = film.camera.fx * candidate.size / middle.z;
            if facing < 0.3 { 0.0 } else { pixels.min(80.0) * facing }
        })
        .sum()
}

fn paper(candidate: &Candidate, id: u32, label: u8) -> anyhow::Result<Solid> {
    let cells = bit_pattern(id)?;
    let texture = Texture::pattern(&cells, candidate.size, PAPER_SIDE * candidate.size);
    let half = (0.5 * PAPER_SIDE * candidate.size) as f32;
    Ok(Solid {
        form: Form::Plate(Cuboid::new(PVector::new(half, half, 0.5 * THICKNESS as f32))),
        body_from_solid: candidate.part_from_tag,
        material: Material { texture: Arc::new(texture), depth_loss: 0.0 },
        label,
    })
}
