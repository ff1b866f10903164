//! Descriptors of features, as unit vectors that are compared by Euclidean distance.

#[cfg(feature = "paper")]
use super::surf::{SURF_LENGTH, Surf, SurfPoint};
use crate::image::gray::Gray;
use nalgebra::Point2;
use opencv::core::{KeyPoint, KeyPointTraitConst, Mat, Vector};
use opencv::features2d::SIFT;
use opencv::prelude::*;
use serde::{Deserialize, Serialize};

/// SURF scale of tracked features, pixels; the described square is 20 times as wide.
#[cfg(feature = "paper")]
const SURF_SCALE: f32 = 1.2;

/// The descriptor that verifies a tracked feature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DescriptorKind {
    /// Upright SURF, the paper's choice; features do not turn between two frames.
    #[cfg(feature = "paper")]
    Surf,
    /// SIFT, upright.
    Sift,
    /// No descriptor: optical flow and its failure detection alone.
    None,
}

/// One unit vector for each point; empty for [`DescriptorKind::None`].
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Descriptors {
    length: usize,
    values: Vec<f32>,
}

impl Descriptors {
    /// The `i`-th descriptor; empty for [`DescriptorKind::None`].
    pub fn get(&self, i: usize) -> &[f32] {
        &self.values[i * self.length..(i + 1) * self.length]
    }
}

/// Euclidean distance between two descriptors; 0 between empty ones.
pub fn distance(a: &[f32], b: &[f32]) -> f64 {
    f64::from(a.iter().zip(b).map(|(x, y)| (x - y).powi(2)).sum::<f32>()).sqrt()
}

/// Computes the descriptors of given points.
pub fn describe(
    kind: DescriptorKind,
    gray: &Gray,
    points: &[Point2<f32>],
) -> opencv::Result<Descriptors> {
    match kind {
        DescriptorKind::None => Ok(Descriptors::default()),
        #[cfg(feature = "paper")]
        DescriptorKind::Surf => {
            let points: Vec<SurfPoint> =
                points.iter().map(|p| SurfPoint { x: p.x, y: p.y, scale: SURF_SCALE }).collect();
            let values = Surf::new(gray)?.describe(&points, true).concat();
            Ok(Descriptors { length: SURF_LENGTH, values })
        }
        DescriptorKind::Sift => describe_sift(gray, points),
    }
}

fn describe_sift(gray: &Gray, points: &[Point2<f32>]) -> opencv::Result<Descriptors> {
    const LENGTH: usize = 128;
    let mut values = vec![0.0; points.len() * LENGTH];
    if !points.is_empty() {
        let mut keypoints: Vector<KeyPoint> = Vector::new();
        for (i, p) in points.iter().enumerate() {
            keypoints.push(KeyPoint::new_coords(p.x, p.y, 6.0, 0.0, 0.0, 0, i as i32)?);
        }
        let mut rows = Mat::default();
        SIFT::create_def()?.compute(gray.mat(), &mut keypoints, &mut rows)?;
        for (row, keypoint) in keypoints.iter().enumerate() {
            let described = rows.at_row::<f32>(row as i32)?;
            let norm = described.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-6);
            let start = keypoint.class_id() as usize * LENGTH;
            for (value, d) in values[start..start + LENGTH].iter_mut().zip(described) {
                *value = d / norm;
            }
        }
    }
    Ok(Descriptors { length: LENGTH, values })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paint in light of so much strength.
    fn painted(gain: f32) -> Gray {
        let grey = |i: usize| {
            let (u, v) = ((i % 128) as f32, (i / 128) as f32);
            gain * (90.0 + 50.0 * (0.31 * u + 0.12 * v).sin() + 30.0 * (0.37 * v - 0.17 * u).sin())
        };
        let bytes: Vec<u8> = (0..128 * 128).map(|i| grey(i) as u8).collect();
        Gray::new(128, 128, &bytes).unwrap()
    }

    fn kinds() -> Vec<DescriptorKind> {
        #[cfg(feature = "paper")]
        return vec![DescriptorKind::Sift, DescriptorKind::Surf];
        #[cfg(not(feature = "paper"))]
        vec![DescriptorKind::Sift]
    }

    const PLACES: [Point2<f32>; 3] =
        [Point2::new(40.0, 50.0), Point2::new(70.5, 64.25), Point2::new(90.0, 33.0)];

    #[test]
    fn a_description_is_a_unit_vector_and_belongs_to_its_place() {
        for kind in kinds() {
            let forth = describe(kind, &painted(1.0), &PLACES).unwrap();
            let mut reversed = PLACES;
            reversed.reverse();
            let back = describe(kind, &painted(1.0), &reversed).unwrap();
            for i in 0..3 {
                let length: f32 = forth.get(i).iter().map(|x| x * x).sum();
                assert!((length - 1.0).abs() < 1e-3, "{kind:?}: {length}");
                assert!(distance(forth.get(i), back.get(2 - i)) < 1e-6, "{kind:?}");
            }
            assert!(distance(forth.get(0), forth.get(1)) > 0.3, "{kind:?}: places differ");
        }
    }

    #[test]
    fn other_light_hardly_changes_a_description() {
        for kind in kinds() {
            let [bright, dim] =
                [1.0, 0.6].map(|gain| describe(kind, &painted(gain), &PLACES[..1]).unwrap());
            assert!(distance(bright.get(0), dim.get(0)) < 0.1, "{kind:?}");
        }
    }

    #[test]
    fn without_a_descriptor_all_places_are_alike() {
        let nothing = describe(DescriptorKind::None, &painted(1.0), &PLACES).unwrap();
        assert!((0..3).all(|i| nothing.get(i).is_empty()));
        assert_eq!(distance(nothing.get(0), nothing.get(2)), 0.0);
    }

    #[test]
    fn no_places_have_no_descriptions() {
        for kind in kinds() {
            assert!(describe(kind, &painted(1.0), &[]).unwrap().values.is_empty());
        }
    }
}
