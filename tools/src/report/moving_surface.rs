//! The surface of a part along its way, and the way of the place that it was held at, drawn into a
//! picture.

use super::draw::{Canvas, Disc, Rgb, part_colour};
use linkage_skill::Pose;
use linkage_skill::object::{Appearance, ObjectModel};
use nalgebra::Point3;

/// Fewer places are no surface.
const LEAST_PLACES: usize = 60;
/// The neighbour that a disc around a place reaches: the discs then leave no gaps.
const NEIGHBOUR: usize = 4;
/// Places of which the distance to that neighbour is measured.
const MEASURED: usize = 200;
/// Opacity of the surface at one place of its way, and at its end.
const OPACITY: [f64; 2] = [0.1, 0.3];
/// Share of the colour at the begin of the way; the end has all of it.
const FAINTEST: f64 = 0.35;

/// What moves, in its part's frame, which is the object frame at configuration 0.
pub struct MovingSurface {
    part: usize,
    places: Vec<Point3<f64>>,
    /// Radius of the disc around a place, metres.
    radius_m: f64,
    /// Where a person held it.
    grasp: Option<Point3<f64>>,
}

impl MovingSurface {
    /// What was learned of a part; `None` where that is too little to be a surface.
    pub fn new(appearance: &Appearance, part: usize) -> Option<Self> {
        let own = appearance.surfels.iter().filter(|s| usize::from(s.part) == part);
        let places: Vec<Point3<f64>> = own.map(|s| Point3::from(s.point.map(f64::from))).collect();
        let radius_m = (places.len() >= LEAST_PLACES).then(|| reach(&places))?;
        Some(Self { part, places, radius_m, grasp: None })
    }

    /// The same with the place that it was held at, where the model tells one.
    pub fn held_as_in(self, model: &ObjectModel) -> Self {
        let grasp = model.parts.get(self.part).and_then(|part| part.grasp).map(Point3::from);
        Self { grasp, ..self }
    }

    /// Draws it at these poses, the last one strongest.
    pub fn draw(&self, canvas: &mut Canvas, camera_from_part: &[Pose]) -> opencv::Result<()> {
        let last = camera_from_part.len().saturating_sub(1);
        for (i, pose) in camera_from_part.iter().enumerate() {
            let places = self.places.iter().map(|p| pose * p);
            let discs: Vec<Disc> = places.filter_map(|p| canvas.disc(&p, self.radius_m)).collect();
            let strength = FAINTEST + (1.0 - FAINTEST) * i as f64 / last.max(1) as f64;
            canvas.veil(
                &discs,
                faded(part_colour(self.part), strength),
                OPACITY[usize::from(i == last)],
            )?;
        }
        match self.grasp {
            None => Ok(()),
            Some(grasp) => {
                let way: Vec<Point3<f64>> =
                    camera_from_part.iter().map(|pose| pose * grasp).collect();
                canvas.way(&way, part_colour(self.part))
            }
        }
    }
}

/// How far most places are from a neighbour, metres.
fn reach(places: &[Point3<f64>]) -> f64 {
    let stride = places.len().div_ceil(MEASURED).max(1);
    let to_neighbour = places.iter().step_by(stride).map(|place| {
        let mut all: Vec<f64> = places.iter().map(|p| (p - place).norm_squared()).collect();
        all.select_nth_unstable_by(NEIGHBOUR, f64::total_cmp).1.sqrt()
    });
    let mut all: Vec<f64> = to_neighbour.collect();
    all.sort_by(f64::total_cmp);
    all[all.len() * 3 / 4]
}

fn faded(colour: Rgb, share: f64) -> Rgb {
    colour.map(|c| (f64::from(c) * share) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
    use linkage_skill::internals::Surfel;
    use std::sync::Arc;

    /// A plate of 20 cm by 20 cm a metre before the camera.
    fn plate(part: u16) -> Appearance {
        let at = |i: usize| [0.02 * (i % 11) as f32 - 0.1, 0.02 * (i / 11) as f32 - 0.1, 1.0];
        let surfel = |i| Surfel { part, point: at(i), normal: [0.0, 0.0, -1.0], lab: [50.0; 3] };
        Appearance { surfels: (0..121).map(surfel).collect(), ..Appearance::default() }
    }

    fn canvas() -> Canvas {
        let camera = PinholeCamera { depth_units_per_metre: 1000.0, ..PinholeCamera::kinect() };
        let (width, height) = (camera.width, camera.height);
        let color = ColorImage::new(width, height, vec![200; 3 * width * height]).unwrap();
        let depth =
            DepthImage::from_raw(width, height, &vec![1500; width * height], 1000.0).unwrap();
        Canvas::new(&RgbdFrame::new(1, Arc::new(camera), color, depth).unwrap()).unwrap()
    }

    /// Pixels that something was drawn on, of a row through the plate's middle.
    fn drawn(picture: &ColorImage, row: usize) -> Vec<usize> {
        (0..picture.width()).filter(|u| picture.at(*u, row) != Some([200; 3])).collect()
    }

    #[test]
    fn a_plate_is_drawn_whole_where_it_was_and_where_it_goes() {
        let mut canvas = canvas();
        let surface = MovingSurface::new(&plate(1), 1).unwrap();
        let way = [Pose::identity(), Pose::translation(0.3, 0.0, 0.0)];
        surface.draw(&mut canvas, &way).unwrap();
        let camera = PinholeCamera::kinect();
        let across = drawn(&canvas.finish().unwrap(), camera.cy as usize);
        let wanted = 2.0 * 0.21 * camera.fx;
        assert!((across.len() as f64 / wanted - 1.0).abs() < 0.15, "{} of {wanted}", across.len());
        let left = camera.cx - 0.105 * camera.fx;
        assert!((across[0] as f64 - left).abs() < 12.0, "{} and {left}", across[0]);
    }

    #[test]
    fn what_lies_far_from_the_surface_is_left_out_and_few_places_are_no_surface() {
        let mut one_astray = plate(1);
        one_astray.surfels[0].point = [0.4, 0.0, 1.0];
        let mut canvas = canvas();
        let surface = MovingSurface::new(&one_astray, 1).unwrap();
        surface.draw(&mut canvas, &[Pose::identity()]).unwrap();
        let camera = PinholeCamera::kinect();
        let across = drawn(&canvas.finish().unwrap(), camera.cy as usize);
        assert!(across.iter().all(|u| (*u as f64) < camera.cx + 0.2 * camera.fx), "{across:?}");
        assert!(MovingSurface::new(&plate(1), 2).is_none());
    }
}
