//! How well the depth pictures agree on a joint's configuration, frame by frame: its uncertainty where
//! no features are tracked.
//!
//! In: places of a part's surface in the part's frame, its poses in the camera frame, its joint's line
//! in the part's frame, the frames that were kept whole. Out: a standard deviation a frame, radians or
//! metres: how far the configuration that a single reading tells is from the one that was learned.
//! Readings far from a hinge count more. A surface that moves within itself, as a sliding door does,
//! tells nothing by depth.

use linkage_driver::RgbdFrame;
use linkage_skill::Pose;
use linkage_skill::internals::{Surfel, Trajectory, plane_through};
use linkage_skill::object::{Appearance, JointGeometry};
use nalgebra::{Point3, Vector3};

/// Most places that are asked for: more are thinned.
const MOST_PLACES: usize = 1_500;
/// Fewer pieces of a part's look are not its surface.
const LEAST_SURFELS: usize = 60;
/// Neighbours that tell the normal at a place.
const NEIGHBOURS: usize = 10;
/// Fewest readings that tell a deviation.
const MIN_READINGS: usize = 20;
/// Share of the places in sight whose readings lie on the surface: else something hides it, or it is
/// not there.
const MIN_SHARE: f64 = 0.5;
/// Cosine between a normal and the line of sight below which a surface is seen too much from its edge.
const MIN_COSINE: f64 = 0.3;
/// Way of a place along its normal for each metre of its whole way, on average, below which a surface
/// moves within itself.
const MIN_WAY_ACROSS: f64 = 0.2;

/// Places of a surface in the part's frame.
pub struct Surface(Vec<Place>);

/// A place of a surface.
#[derive(Clone, Copy)]
struct Place {
    at: Point3<f64>,
    normal: Vector3<f64>,
    /// The normal points outwards: the place is seen from that side alone.
    is_outward: bool,
}

impl Surface {
    /// What was learned of a part's look, of both faces of a lid too; without that, or where it is
    /// little, the places by which the part was found.
    pub fn of(appearance: Option<&Appearance>, part: usize, found_by: &[Point3<f64>]) -> Self {
        let surfels = appearance.map_or(&[][..], |a| a.surfels.as_slice());
        let own: Vec<&Surfel> = surfels.iter().filter(|s| usize::from(s.part) == part).collect();
        if own.len() < LEAST_SURFELS {
            return Self::new(found_by);
        }
        let stride = own.len().div_ceil(MOST_PLACES).max(1);
        let place = |surfel: &&Surfel| Place {
            at: Point3::from(surfel.point.map(f64::from)),
            normal: Vector3::from(surfel.normal.map(f64::from)),
            is_outward: true,
        };
        Self(own.iter().step_by(stride).map(place).collect())
    }

    /// Of places in the part's frame.
    fn new(places: &[Point3<f64>]) -> Self {
        let stride = places.len().div_ceil(MOST_PLACES).max(1);
        let places: Vec<Point3<f64>> = places.iter().step_by(stride).copied().collect();
        let with_normal = |at: &Point3<f64>| {
            Some(Place { at: *at, normal: normal_at(at, &places)?, is_outward: false })
        };
        Self(places.iter().filter_map(with_normal).collect())
    }

    /// Standard deviation in each frame; `None` where the frame was not kept whole, the pose is not
    /// known, or depth does not tell it.
    pub fn deviations<'f>(
        &self,
        keyframes: impl IntoIterator<Item = (usize, &'f RgbdFrame)>,
        camera_from_part: &Trajectory,
        line_in_part: &JointGeometry,
    ) -> Vec<Option<f64>> {
        let mut all = vec![None; camera_from_part.len()];
        for (index, frame) in keyframes {
            if let Some(pose) = camera_from_part.get(index).copied().flatten() {
                all[index] = self.deviation(frame, &pose, line_in_part);
            }
        }
        all
    }

    fn deviation(
        &self,
        frame: &RgbdFrame,
        camera_from_part: &Pose,
        line_in_part: &JointGeometry,
    ) -> Option<f64> {
        let (mut in_sight, mut readings) = (0_usize, 0_usize);
        let (mut residual, mut across, mut way) = (0.0, 0.0, 0.0);
        for Place { at: place, normal, is_outward } in &self.0 {
            let (at, out) = (camera_from_part * place, camera_from_part * normal);
            let towards_camera = -out.dot(&at.coords.normalize());
            let cosine = if *is_outward { towards_camera } else { towards_camera.abs() };
            let Some(reading) = reading_at(frame, &at).filter(|_| cosine > MIN_COSINE) else {
                continue;
            };
            in_sight += 1;
            let tolerance = frame.camera.depth_sensor.tolerance(at.z, cosine);
            if (reading.z - at.z).abs() > tolerance {
                continue;
            }
            readings += 1;
            residual += out.dot(&(reading - at)).powi(2);
            let velocity = line_in_part.velocity(place);
            across += velocity.dot(normal).powi(2);
            way += velocity.norm_squared();
        }
        let told = readings >= MIN_READINGS
            && readings as f64 >= MIN_SHARE * in_sight as f64
            && across > MIN_WAY_ACROSS.powi(2) * way;
        told.then(|| (residual / across).sqrt())
    }
}

/// The point that the depth picture shows where a place is seen.
fn reading_at(frame: &RgbdFrame, place: &Point3<f64>) -> Option<Point3<f64>> {
    let pixel = frame.camera.project(place)?;
    let z = frame.depth.at_nearest(pixel.x, pixel.y)?;
    Some(frame.camera.back_project(pixel.x, pixel.y, f64::from(z)))
}

/// Normal of the plane through the neighbours of a place; its sign is not determined.
fn normal_at(place: &Point3<f64>, places: &[Point3<f64>]) -> Option<Vector3<f64>> {
    if places.len() < NEIGHBOURS {
        return None;
    }
    let mut by_distance: Vec<(f64, &Point3<f64>)> =
        places.iter().map(|p| ((p - place).norm_squared(), p)).collect();
    by_distance.select_nth_unstable_by(NEIGHBOURS - 1, |a, b| a.0.total_cmp(&b.0));
    let near: Vec<Point3<f64>> = by_distance[..NEIGHBOURS].iter().map(|(_, p)| **p).collect();
    Some(plane_through(&near).1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_driver::{ColorImage, DepthImage, PinholeCamera};
    use nalgebra::UnitVector3;
    use std::sync::Arc;

    /// A wall a metre before the camera, of which every other reading is this much too near and the
    /// others as much too far.
    fn wall(error_m: f64) -> RgbdFrame {
        let camera = Arc::new(PinholeCamera::kinect());
        let (width, height) = (camera.width, camera.height);
        let metres = (0..width * height).map(|i| {
            let sign = if (i % width + i / width) % 2 == 0 { 1.0 } else { -1.0 };
            (1.0 + sign * error_m) as f32
        });
        let depth = DepthImage::from_metres(width, height, metres.collect()).unwrap();
        let color = ColorImage::new(width, height, vec![0; 3 * width * height]).unwrap();
        RgbdFrame::new(0, camera, color, depth).unwrap()
    }

    /// A square of 30 cm, a metre before the camera, in its part's frame.
    fn surface() -> Surface {
        let places = (0..30).flat_map(|i| (0..30).map(move |k| (f64::from(i), f64::from(k))));
        let places: Vec<Point3<f64>> =
            places.map(|(i, k)| Point3::new(0.01 * i - 0.15, 0.01 * k - 0.15, 1.0)).collect();
        Surface::new(&places)
    }

    fn told(frame: &RgbdFrame, pose: Pose, line: &JointGeometry) -> Option<f64> {
        surface().deviations([(1, frame)], &vec![Some(pose); 3], line)[1]
    }

    fn slide(axis: UnitVector3<f64>) -> JointGeometry {
        JointGeometry::slide(axis, Point3::origin())
    }

    #[test]
    fn the_noise_of_readings_is_the_deviation_of_a_drawer() {
        let told = told(&wall(0.004), Pose::identity(), &slide(Vector3::z_axis())).unwrap();
        assert!((told - 0.004).abs() < 3e-4, "{told}");
    }

    #[test]
    fn readings_far_from_a_hinge_tell_its_angle_better() {
        let at = |x: f64| JointGeometry::hinge(Vector3::y_axis(), Point3::new(x, 0.0, 1.0));
        let [near, far] =
            [-0.2, -1.0].map(|x| told(&wall(0.004), Pose::identity(), &at(x)).unwrap());
        assert!((far - 0.004).abs() < 5e-4 && near > 3.0 * far, "{near} {far}");
    }

    #[test]
    fn the_face_of_a_plate_that_is_turned_away_tells_nothing() {
        let face = |z: f64, out: f32| {
            let Surface(places) = surface();
            places.into_iter().map(move |place| Surfel {
                part: 1,
                point: Vector3::new(place.at.x, place.at.y, z).map(|x| x as f32).into(),
                normal: [0.0, 0.0, out],
                lab: [50.0, 0.0, 0.0],
            })
        };
        let surfels = face(1.0, -1.0).chain(face(1.03, 1.0)).collect();
        let plate = Appearance { surfels, ..Appearance::default() };
        let told = Surface::of(Some(&plate), 1, &[]).deviations(
            [(0, &wall(0.003))],
            &vec![Some(Pose::identity())],
            &slide(Vector3::z_axis()),
        );
        assert!((told[0].unwrap() - 0.003).abs() < 3e-4, "{told:?}");
    }

    #[test]
    fn a_surface_that_slides_within_itself_or_is_not_there_tells_nothing() {
        assert_eq!(told(&wall(0.001), Pose::identity(), &slide(Vector3::x_axis())), None);
        let away = Pose::translation(0.0, 0.0, 0.2);
        assert_eq!(told(&wall(0.001), away, &slide(Vector3::z_axis())), None);
        let line = slide(Vector3::z_axis());
        let none = surface().deviations([], &vec![Some(Pose::identity()); 3], &line);
        assert_eq!(none, [None; 3], "no frame was kept whole");
    }
}
