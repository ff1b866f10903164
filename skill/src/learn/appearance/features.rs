//! Describes the features of the object in several keyframes, and merges the views of one point.
//!
//! In: labelled keyframes with the pose of each part.
//! Out: features of the object and of the room, in the object frame at configuration 0, metres.
//! From: RootSIFT descriptors, where the paper (section III-A) has SURF.

use super::part_labels::{LabelGrid, PosedFrame};
use super::region::Region;
use crate::features::quantised::{product, quantise, similarity};
use crate::features::{FeatureDensity, FeatureKind, Keypoints};
use crate::math::grid::cell;
use crate::object::appearance::ModelFeature;
use linkage_frames::depth::NormalMap;
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// Largest distance between two views of one point, metres.
const MERGE_M: f64 = 0.015;

/// Part, and cell of the object frame.
type PlaceKey = (u16, [i32; 3]);

/// The features that a keyframe shows, in the object frame at configuration 0.
#[derive(Default)]
pub struct SeenFeatures {
    /// Features on the object.
    pub own: Vec<ModelFeature>,
    /// Features on the static surface around the object.
    pub room: Vec<ModelFeature>,
}

/// The features that a keyframe shows on the object and around it.
pub fn seen_features(
    posed: &PosedFrame,
    grid: &LabelGrid,
    region: &Region,
    normals: &NormalMap,
) -> opencv::Result<SeenFeatures> {
    let on_a_part = |u, v| grid.at(u, v).is_some();
    let keypoints = Keypoints::new(posed.frame, FeatureDensity::Model, on_a_part)?;
    let mut seen = SeenFeatures::default();
    for feature in keypoints.describe(posed.frame, normals)? {
        let (u, v) = (feature.pixel[0] as usize, feature.pixel[1] as usize);
        let (Some(part), Some(point)) = (grid.at(u, v), feature.point) else { continue };
        let Some(pose) = posed.camera_from_part[usize::from(part)] else { continue };
        let at_rest = pose.inverse_transform_point(&point);
        let is_own = part != 0 || region.is_own_base(&region.features, &at_rest, point.z);
        let is_room = !is_own && !grid.is_dynamic(u, v) && !region.is_dynamic(&at_rest);
        let placed = || ModelFeature {
            part,
            kind: feature.kind,
            point: at_rest.coords.map(|x| x as f32).into(),
            normal: pose.inverse_transform_vector(&feature.normal).map(|x| x as f32).into(),
            size_m: feature.size as f32,
            descriptor: quantise(&feature.descriptor).to_vec(),
        };
        if is_own {
            seen.own.push(placed());
        } else if is_room {
            seen.room.push(placed());
        }
    }
    Ok(seen)
}

/// Merges views of one point (same part and kind, near position, similar size and descriptor) into one feature. At
/// most half of `per_part` features per part and kind are kept, the most often seen first. Each feature comes with
/// the index of its keyframe.
pub fn merged(features: Vec<(ModelFeature, usize)>, per_part: usize) -> Vec<ModelFeature> {
    let mut cells: HashMap<PlaceKey, Vec<usize>> = HashMap::new();
    for (i, (f, _)) in features.iter().enumerate() {
        let p = Point3::from(Vector3::from(f.point).map(f64::from));
        cells.entry((f.part, cell(&p, 2.0 * MERGE_M))).or_default().push(i);
    }
    let mut groups: Vec<(PlaceKey, Vec<usize>)> = cells.into_iter().collect();
    groups.sort_by_key(|(key, _)| *key);
    let mut kept: Vec<(usize, usize)> = Vec::new();
    for (_, mut members) in groups {
        while let Some((best, support)) = members
            .iter()
            .map(|&i| {
                (i, members.iter().filter(|&&j| alike(&features[i].0, &features[j].0)).count())
            })
            .max_by_key(|&(i, support)| (support, std::cmp::Reverse(i)))
        {
            kept.push((best, support));
            members.retain(|&j| !alike(&features[best].0, &features[j].0));
        }
    }
    kept.sort_by_key(|&(i, support)| (std::cmp::Reverse(support), i));
    let mut taken: HashMap<(u16, FeatureKind), usize> = HashMap::new();
    let mut result: Vec<ModelFeature> = Vec::new();
    for (i, _) in kept {
        let feature = &features[i].0;
        let count = taken.entry((feature.part, feature.kind)).or_default();
        if *count < per_part / 2 {
            *count += 1;
            result.push(feature.clone());
        }
    }
    result.sort_by_key(|f| f.part);
    result
}

/// True if two features may be views of one point.
fn alike(a: &ModelFeature, b: &ModelFeature) -> bool {
    let apart = Vector3::from(a.point) - Vector3::from(b.point);
    let size = (a.size_m / b.size_m).ln().abs();
    let distance_sq = 2.0 - 2.0 * similarity(product(&a.descriptor, &b.descriptor));
    a.kind == b.kind && f64::from(apart.norm()) < MERGE_M && size < 0.3 && distance_sq < 0.2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::DESCRIPTOR_LENGTH;

    /// A feature of a part; features of other numbers have other descriptors.
    fn feature(part: u16, x: f32, number: usize) -> ModelFeature {
        let mut descriptor = [0.0; DESCRIPTOR_LENGTH];
        (0..4).for_each(|i| descriptor[4 * number + i] = 0.5);
        ModelFeature {
            part,
            kind: FeatureKind::Picture,
            point: [x, 0.01, 1.01],
            normal: [0.0, 0.0, -1.0],
            size_m: 0.01,
            descriptor: quantise(&descriptor).to_vec(),
        }
    }

    /// The features that are left, by part and place.
    fn kept(features: &[ModelFeature], per_part: usize) -> Vec<(u16, f32)> {
        let seen = features.iter().cloned().enumerate().map(|(i, f)| (f, i)).collect();
        merged(seen, per_part).iter().map(|f| (f.part, f.point[0])).collect()
    }

    #[test]
    fn views_of_one_point_become_one_feature() {
        let views = [feature(0, 0.010, 1), feature(0, 0.012, 1), feature(0, 0.011, 1)];
        assert_eq!(kept(&views, 100).len(), 1);
    }

    #[test]
    fn what_differs_in_look_place_part_kind_or_size_stays_apart() {
        let one = feature(0, 0.01, 1);
        let others = [
            feature(0, 0.01, 2),
            feature(0, 0.20, 1),
            feature(1, 0.01, 1),
            ModelFeature { kind: FeatureKind::Rectified, ..one.clone() },
            ModelFeature { size_m: 0.02, ..one.clone() },
        ];
        for other in others {
            assert_eq!(kept(&[one.clone(), other], 100).len(), 2);
        }
    }

    #[test]
    fn the_points_that_are_seen_most_often_are_kept_first() {
        let seen = |x: f32, times: usize, number| vec![feature(0, x, number); times];
        let all = [seen(0.1, 1, 1), seen(0.3, 3, 2), seen(0.5, 2, 3)].concat();
        // At most half of `per_part` features are of one kind.
        assert_eq!(kept(&all, 4), [(0, 0.3), (0, 0.5)]);
        assert_eq!(kept(&all, 2), [(0, 0.3)]);
        assert!(kept(&all, 0).is_empty());
    }

    #[test]
    fn they_come_part_by_part_and_each_part_has_its_own_number() {
        let all = [feature(1, 0.1, 1), feature(0, 0.3, 2), feature(1, 0.5, 3), feature(0, 0.7, 4)];
        assert_eq!(kept(&all, 2), [(0, 0.3), (1, 0.1)]);
        assert_eq!(kept(&all, 4).iter().map(|(part, _)| *part).collect::<Vec<_>>(), [0, 0, 1, 1]);
        assert!(kept(&[], 10).is_empty());
    }
}
