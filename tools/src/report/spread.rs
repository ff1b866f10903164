//! How well tracked features agree on a joint's configuration, frame by frame: the uncertainty of the
//! configuration as the tracks tell it.
//!
//! In: tracks of a part, its poses in the camera frame, its joint's line in the part's frame. Out: a
//! standard deviation a frame, radians or metres: how far the configuration that a single feature
//! tells is from the one that was learned. Features far from a hinge count more.

use linkage_skill::internals::{Track, Trajectory};
use linkage_skill::object::JointGeometry;
use nalgebra::{Point3, Vector3};

/// Fewest features that tell a deviation.
const MIN_FEATURES: usize = 3;

/// Standard deviation in each frame; `None` where the pose is not known or few features are seen.
pub fn deviations<'t>(
    tracks: impl IntoIterator<Item = &'t Track>,
    camera_from_part: &Trajectory,
    line_in_part: &JointGeometry,
) -> Vec<Option<f64>> {
    let mut sums = vec![(0_usize, 0.0, 0.0); camera_from_part.len()];
    for track in tracks {
        let places: Vec<(usize, Point3<f64>)> = track
            .lifted()
            .filter_map(|(f, p)| {
                let pose = camera_from_part.get(f)?.as_ref()?;
                Some((f, pose.inverse_transform_point(&p)))
            })
            .collect();
        if places.len() < 2 {
            continue;
        }
        let sum: Vector3<f64> = places.iter().map(|(_, p)| p.coords).sum();
        let mean = Point3::from(sum / places.len() as f64);
        let along = line_in_part.velocity(&mean);
        for (f, place) in places {
            let (count, residual, lever) = &mut sums[f];
            *count += 1;
            // Along the way of the point; across it a configuration changes nothing.
            *residual += along.dot(&(place - mean)).powi(2) / along.norm_squared().max(1e-9);
            *lever += along.norm_squared();
        }
    }
    let deviation = |(count, residual, lever): (usize, f64, f64)| {
        (count >= MIN_FEATURES && lever > 0.0).then(|| (residual / lever).sqrt())
    };
    sums.into_iter().map(deviation).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_skill::Pose;
    use linkage_skill::internals::{Observation, TrackId};
    use nalgebra::Point2;

    /// A feature 1 m from the hinge that departs from its place along its way.
    fn track(x: f64, departures_m: &[f64]) -> Track {
        let seen = |d: &f64| Observation {
            pixel: Point2::origin(),
            point_in_camera: Some(Point3::new(x, 0.0, *d)),
            normal_in_camera: None,
        };
        Track {
            id: TrackId(0),
            first_frame: 0,
            observations: departures_m.iter().map(seen).collect(),
        }
    }

    #[test]
    fn features_that_depart_along_their_way_tell_the_deviation() {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let tracks =
            [track(1.0, &[0.01, -0.01]), track(-1.0, &[-0.01, 0.01]), track(1.0, &[0.01, -0.01])];
        let poses = vec![Some(Pose::identity()); 3];
        let told = deviations(&tracks, &poses, &hinge);
        assert!((told[0].unwrap() - 0.01).abs() < 1e-4, "{told:?}");
        assert_eq!(told[2], None);
        assert_eq!(deviations(&tracks[..2], &poses, &hinge)[0], None);
    }
}
