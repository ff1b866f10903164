//! Ray casting of solids: colour with light, motion blur and smooth edges; depth with normals
//! and labels. Intersections come from parry3d; here is only what a camera adds.

use super::world::{Hit, Solid};
use linkage_driver::PinholeCamera;
use linkage_skill::Pose;
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// A solid as one camera sees it.
struct Placed<'s> {
    solid: &'s Solid,
    solid_from_camera: Pose,
    origin: Vector3<f64>,
    /// Pixels that it may cover: left, top, right, bottom.
    bounds: [f64; 4],
    /// No place of it is nearer to the camera's plane, metres.
    nearest_m: f32,
    /// Of two solids at the same place the one is seen that was named first.
    number: usize,
}

/// What rounding may change in a distance, metres.
const ROUNDING_M: f64 = 1e-3;

/// All solids before one camera at one instant, the nearest first.
pub struct View<'s> {
    camera: &'s PinholeCamera,
    world_from_camera: Pose,
    placed: Vec<Placed<'s>>,
}

/// What may be seen in a row of the picture, the nearest first, and the columns that it may cover.
struct Row<'p, 's> {
    placed: Vec<&'p Placed<'s>>,
    left: f64,
    right: f64,
}

/// Light of a room.
#[derive(Clone, Copy)]
pub struct Light {
    /// Where the lamp is.
    pub lamp: Point3<f64>,
    /// Share of light that comes from everywhere.
    pub ambient: f64,
    /// Overall brightness.
    pub gain: f64,
}

/// What a pixel's ray meets first.
#[derive(Clone, Copy)]
pub struct Seen<T> {
    /// Depth along the optical axis, metres.
    distance: f32,
    /// Of two solids at the same place the one is seen that was named first.
    number: usize,
    /// What is made of it.
    shows: T,
}

/// What the pixels of a picture show, row by row; `None` where nothing is.
pub type Layer<T> = Vec<Option<Seen<T>>>;

/// What a pixel's ray meets.
#[derive(Clone, Copy)]
pub struct SurfacePoint {
    /// Depth along the optical axis, metres.
    pub z: f64,
    /// Cosine between the normal and the direction to the camera.
    pub cosine: f64,
    /// Label of the body.
    pub label: u8,
    /// Share of depth readings that get lost.
    pub depth_loss: f64,
}

impl<'s> View<'s> {
    /// Places solids, each with its number and the pose of its body in the world.
    pub fn new(
        camera: &'s PinholeCamera,
        camera_from_world: &Pose,
        solids: impl Iterator<Item = (usize, (&'s Solid, Pose))>,
    ) -> Self {
        let mut placed: Vec<Placed> = solids
            .filter_map(|(number, (solid, world_from_body))| {
                let camera_from_solid = camera_from_world * world_from_body * solid.body_from_solid;
                let centre = Point3::from(camera_from_solid.translation.vector);
                let corners = solid.corners().map(|all| all.map(|c| camera_from_solid * c));
                let (bounds, nearest_m) = match corners {
                    Some(corners) => (
                        corner_bounds(camera, &corners)?,
                        corners.iter().map(|c| c.z).fold(f64::INFINITY, f64::min),
                    ),
                    None => {
                        let radius = solid.bounding_radius();
                        (bounds(camera, &centre, radius)?, centre.z - radius)
                    }
                };
                let nearest_m = (nearest_m - ROUNDING_M) as f32;
                let solid_from_camera = camera_from_solid.inverse();
                let origin = solid_from_camera.translation.vector;
                Some(Placed { solid, solid_from_camera, origin, bounds, nearest_m, number })
            })
            .collect();
        placed.sort_by(|a, b| a.nearest_m.total_cmp(&b.nearest_m));
        Self { camera, world_from_camera: camera_from_world.inverse(), placed }
    }

    /// What may be seen in a row of the picture, the nearest first.
    fn row(&self, v: f64) -> Row<'_, 's> {
        let all = self.placed.iter().filter(|p| v >= p.bounds[1] && v <= p.bounds[3]);
        let placed: Vec<&Placed> = all.collect();
        let left = placed.iter().map(|p| p.bounds[0]).fold(f64::INFINITY, f64::min);
        let right = placed.iter().map(|p| p.bounds[2]).fold(f64::NEG_INFINITY, f64::max);
        Row { placed, left, right }
    }

    /// What a pixel shows of its row before what is `behind`: a depth, metres, and a number.
    fn nearest<'p>(
        &self,
        row: &Row<'p, 's>,
        [u, v]: [f64; 2],
        behind: Option<(f32, usize)>,
    ) -> Option<(&'p Placed<'s>, Hit, Vector3<f64>)> {
        if u < row.left || u > row.right {
            return None;
        }
        let ray = self.camera.back_project(u, v, 1.0).coords;
        let mut best: Option<(&Placed, Hit)> = None;
        for p in &row.placed {
            let before = best.as_ref().map(|(p, h)| (h.distance, p.number)).or(behind);
            let limit = before.map_or(20.0, |(distance, _)| distance);
            // The ray has unit depth: its length to a place is the place's depth.
            if p.nearest_m > limit {
                break;
            }
            if u < p.bounds[0] || u > p.bounds[2] {
                continue;
            }
            let direction = p.solid_from_camera.rotation * ray;
            if let Some(hit) = p.solid.cast(&p.origin, &direction, limit)
                && hit.distance > 0.0
                && before.is_none_or(|(distance, number)| {
                    hit.distance < distance || hit.distance == distance && p.number < number
                })
            {
                best = Some((p, hit));
            }
        }
        best.map(|(p, hit)| (p, hit, ray))
    }

    /// What a pixel shows of its row, or of what is behind it.
    fn seen<T: Copy>(
        &self,
        row: &Row,
        pixel: [f64; 2],
        behind: Option<Seen<T>>,
        shows: impl Fn(&Placed, &Hit, &Vector3<f64>) -> T,
    ) -> Option<Seen<T>> {
        match self.nearest(row, pixel, behind.as_ref().map(|b| (b.distance, b.number))) {
            Some((p, hit, ray)) => {
                let (distance, number) = (hit.distance, p.number);
                Some(Seen { distance, number, shows: shows(p, &hit, &ray) })
            }
            None => behind,
        }
    }

    /// A layer of what each pixel shows, at a place within it, before what is behind it.
    fn layer<T: Copy + Send + Sync>(
        &self,
        [du, dv]: [f64; 2],
        behind: Option<&Layer<T>>,
        shows: impl Fn(&Placed, &Hit, &Vector3<f64>) -> T + Sync,
    ) -> Layer<T> {
        let width = self.camera.width;
        let mut all = vec![None; width * self.camera.height];
        all.par_chunks_mut(width).enumerate().for_each(|(line, layer)| {
            let v = line as f64 + dv;
            let row = self.row(v);
            for (u, seen) in layer.iter_mut().enumerate() {
                let behind = behind.and_then(|layer| layer[line * width + u]);
                *seen = self.seen(&row, [u as f64 + du, v], behind, &shows);
            }
        });
        all
    }

    /// The surface that a ray meets.
    fn surface(p: &Placed, hit: &Hit, ray: &Vector3<f64>) -> SurfacePoint {
        let normal = p.solid_from_camera.rotation.inverse() * hit.normal;
        SurfacePoint {
            z: f64::from(hit.distance),
            cosine: -normal.dot(&ray.normalize()),
            label: p.solid.label,
            depth_loss: p.solid.material.depth_loss,
        }
    }

    /// Lit colour of what a ray meets, 0-255.
    fn colour(&self, p: &Placed, hit: &Hit, ray: &Vector3<f64>, light: &Light) -> [f32; 3] {
        let (x, y) = p.solid.surface_coordinates(hit);
        let paint = p.solid.material.texture.at(x, y);
        let in_camera = Point3::from(ray * f64::from(hit.distance));
        let in_world = self.world_from_camera * in_camera;
        let normal =
            self.world_from_camera.rotation * (p.solid_from_camera.rotation.inverse() * hit.normal);
        let to_lamp = (light.lamp - in_world).normalize();
        let lit = light.ambient + (1.0 - light.ambient) * normal.dot(&to_lamp).max(0.0);
        let strength = (light.gain * lit) as f32;
        paint.map(|c| c * strength)
    }

    /// Surfaces of all pixels before a backdrop.
    pub fn surfaces(&self, backdrop: Option<&Backdrop>) -> Vec<Option<SurfacePoint>> {
        let behind = backdrop.map(|b| &b.surfaces);
        let layer = self.layer([0.0; 2], behind, Self::surface);
        layer.into_iter().map(|seen| seen.map(|s| s.shows)).collect()
    }
}

/// What the solids that never move show to a camera that never moves: rendered once for all frames of a recording.
pub struct Backdrop {
    /// For each place within a pixel.
    colours: [Layer<[f32; 3]>; PLACES.len()],
    surfaces: Layer<SurfacePoint>,
}

impl Backdrop {
    /// What a view shows.
    pub fn new(view: &View, light: &Light) -> Self {
        let colour = |p: &Placed, hit: &Hit, ray: &Vector3<f64>| view.colour(p, hit, ray, light);
        Self {
            colours: PLACES.map(|place| view.layer(place, None, colour)),
            surfaces: view.layer([0.0; 2], None, View::surface),
        }
    }
}

/// Places within a pixel at which colours are taken, one an instant.
const PLACES: [[f64; 2]; 4] = [[-0.25, -0.25], [0.25, 0.25], [-0.25, 0.25], [0.25, -0.25]];

/// Colour where nothing is.
const NOTHING: [f32; 3] = [30.0; 3];

/// Mean of the colours of views at several instants of the exposure, each at another place
/// within the pixel, before a backdrop; linear, 0-255 and above.
pub fn expose(views: &[View], light: &Light, backdrop: Option<&Backdrop>) -> Vec<[f32; 3]> {
    let camera = views[0].camera;
    let width = camera.width;
    let mut all = vec![[0.0; 3]; width * camera.height];
    all.par_chunks_mut(width).enumerate().for_each(|(line, colours)| {
        for (view, (k, [du, dv])) in views.iter().zip(PLACES.into_iter().enumerate().cycle()) {
            let v = line as f64 + dv;
            let row = view.row(v);
            let behind = backdrop.map(|b| &b.colours[k][line * width..]);
            for (u, sum) in colours.iter_mut().enumerate() {
                let behind = behind.and_then(|layer| layer[u]);
                let shows =
                    |p: &Placed, hit: &Hit, ray: &Vector3<f64>| view.colour(p, hit, ray, light);
                let seen = view.seen(&row, [u as f64 + du, v], behind, shows);
                let colour = seen.map_or(NOTHING, |s| s.shows);
                sum.iter_mut().zip(colour).for_each(|(s, c)| *s += c);
            }
        }
        for sum in colours {
            *sum = sum.map(|s| s / views.len() as f32);
        }
    });
    all
}

/// Pixels that a box may cover, from its corners; all of the picture where one of them is
/// beside or behind the camera, `None` where all are.
fn corner_bounds(camera: &PinholeCamera, corners: &[Point3<f64>; 8]) -> Option<[f64; 4]> {
    if corners.iter().all(|c| c.z < 0.1) {
        return None;
    }
    if corners.iter().any(|c| c.z < 0.1) {
        return Some([-1.0, -1.0, camera.width as f64, camera.height as f64]);
    }
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for p in corners.iter().filter_map(|c| camera.project(c)) {
        bounds = [bounds[0].min(p.x), bounds[1].min(p.y), bounds[2].max(p.x), bounds[3].max(p.y)];
    }
    Some([bounds[0] - 1.0, bounds[1] - 1.0, bounds[2] + 1.0, bounds[3] + 1.0])
}

/// Pixels that a ball may cover; `None` behind the camera.
fn bounds(camera: &PinholeCamera, centre: &Point3<f64>, radius: f64) -> Option<[f64; 4]> {
    let far = centre.z + radius;
    if far < 0.1 {
        return None;
    }
    let near = centre.z - radius;
    if near < 0.1 {
        return Some([-1.0, -1.0, camera.width as f64, camera.height as f64]);
    }
    let span = |c: f64, f: f64, centre_px: f64| {
        let low = f * ((c - radius) / near).min((c - radius) / far) + centre_px;
        let high = f * ((c + radius) / near).max((c + radius) / far) + centre_px;
        (low - 1.0, high + 1.0)
    };
    let (l, r) = span(centre.x, camera.fx, camera.cx);
    let (t, b) = span(centre.y, camera.fy, camera.cy);
    Some([l, t, r, b])
}
