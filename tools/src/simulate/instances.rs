//! The 43 demonstrations of the paper's experiment (section IV): its ten kinds and counts,
//! each time another thing of the kind, seen from elsewhere, moved at another pace.

use super::devices;
use super::furniture::{
    cabinet, door, drawers, fridge, furnish, laptop, microwave, office_chair, stand_of,
};
use super::kit::Look;
use super::texture::Richness;
use super::world::Scene;
use linkage_skill::object::JointKind;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Kinds with the number of their demonstrations, in the order of the paper's tables.
pub const KINDS: [(&str, usize); 10] = [
    ("door", 7),
    ("drawer", 7),
    ("fridge", 8),
    ("laptop", 5),
    ("microwave", 4),
    ("printer", 2),
    ("screen", 2),
    ("chair", 3),
    ("monitor", 2),
    ("bicycle", 3),
];

/// Names of all demonstrations: `door_1` to `bicycle_3`.
pub fn names() -> impl Iterator<Item = String> {
    KINDS.iter().flat_map(|(kind, count)| (1..=*count).map(move |i| format!("{kind}_{i}")))
}

/// The seed that a demonstration is rendered with.
pub fn seed_of(name: &str) -> u64 {
    4300 + names().position(|n| n == name).unwrap_or(0) as u64
}

/// A demonstration by name; `None` for any other name.
pub fn demonstration(name: &str) -> Option<Scene> {
    let (kind, number) = name.split_once('_')?;
    let number: usize = number.parse().ok()?;
    let (_, count) = KINDS.iter().find(|(k, _)| *k == kind)?;
    if !(1..=*count).contains(&number) {
        return None;
    }
    let seed = seed_of(name);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // Every third thing has little texture, one in eight hardly any.
    let richness = match seed % 8 {
        3 => Richness::Poor,
        1 | 6 => Richness::Medium,
        _ => Richness::Rich,
    };
    let look = Look { name, richness };
    let mut scene = match (kind, number) {
        ("door", 3 | 6) => cabinet(look),
        ("door", _) => door(look),
        ("drawer", _) => drawers(look, 1),
        ("fridge", _) => fridge(look),
        ("laptop", _) => laptop(look),
        ("microwave", _) => microwave(look),
        ("printer", 1) => devices::printer_tray(look),
        ("printer", _) => devices::printer_lid(look),
        ("screen", 1) => devices::screen(look),
        ("screen", _) => devices::screen_turned(look),
        ("chair", _) => office_chair(look),
        ("monitor", _) => devices::monitor(look),
        _ => devices::bicycle(look),
    };
    reshape(&mut scene, &mut rng);
    film_otherwise(&mut scene, number, &mut rng);
    furnish(&mut scene, seed);
    scene.name = name.to_owned();
    Some(scene)
}

/// Another size, other proportions, perhaps mirrored.
fn reshape(scene: &mut Scene, rng: &mut ChaCha8Rng) {
    let even = rng.random_range(0.88..1.15);
    let uneven = [0, 1, 2].map(|_| rng.random_range(0.93..1.08));
    let mirrored = if rng.random_bool(0.4) { -1.0 } else { 1.0 };
    // Slanted axes keep their direction only when all sides change alike.
    let proportions = if scene.category == "bicycle" { [1.0; 3] } else { uneven };
    let stretch = Vector3::from(proportions).component_mul(&Vector3::new(mirrored, 1.0, 1.0));
    stretch_about_its_stand(scene, &(even * stretch));
    scene.view[0] *= mirrored;
    scene.view[2] *= even.max(1.0);
}

/// Stretches the object along the world's axes; a negative x mirrors it.
pub fn stretch_about_its_stand(scene: &mut Scene, stretch: &Vector3<f64>) {
    let about = Point3::new(0.0, 0.0, stand_of(scene).unwrap_or(0.0));
    let moved = |p: &Point3<f64>| about + (p - about).component_mul(stretch);
    let mirrored = stretch.x.signum();
    for part in &mut scene.parts {
        for solid in &mut part.solids {
            *solid = solid.reshaped(&about, stretch);
        }
    }
    for joint in &mut scene.joints {
        joint.origin = moved(&joint.origin);
        joint.grasp = moved(&joint.grasp);
        joint.person.x *= mirrored;
        // Turning is mirrored to turning the other way.
        joint.axis = match joint.kind {
            JointKind::Prismatic => {
                Vector3::new(mirrored * joint.axis.x, joint.axis.y, joint.axis.z)
            }
            _ => Vector3::new(joint.axis.x, mirrored * joint.axis.y, mirrored * joint.axis.z),
        };
        joint.pitch *= mirrored;
    }
    scene.target = moved(&scene.target);
}

/// Another viewpoint, pace and reach; partial views; somebody else in the picture.
fn film_otherwise(scene: &mut Scene, number: usize, rng: &mut ChaCha8Rng) {
    let [azimuth, elevation, distance] = &mut scene.view;
    *azimuth += rng.random_range(-12.0..12.0);
    *elevation += rng.random_range(-4.0..6.0);
    *distance *= rng.random_range(0.92..1.15);
    let pace = rng.random_range(0.8..1.25);
    let reach = rng.random_range(0.7..1.05);
    for action in &mut scene.actions {
        action.start *= pace;
        action.end *= pace;
        action.to *= reach;
    }
    scene.duration *= pace.max(0.9);
    if number % 4 == 3 {
        scene.target.x += rng.random_range(-0.18..0.18) * scene.view[2];
    }
    scene.passer_by = number % 4 == 2;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_the_papers_43_demonstrations_and_each_can_be_filmed() {
        let all: Vec<String> = names().collect();
        assert_eq!(all.len(), 43);
        for name in all {
            let scene = demonstration(&name).unwrap();
            assert_eq!(scene.name, name);
            assert!(scene.actions.iter().all(|a| a.end < scene.duration), "{name}");
        }
        assert!(demonstration("door_8").is_none());
    }

    #[test]
    fn a_mirrored_thing_moves_as_its_mirror_image() {
        for plain in [door, office_chair, devices::printer_tray, devices::bicycle, devices::stool] {
            let plain = plain(Look { name: "x", richness: Richness::Poor });
            let mut mirrored = plain.clone();
            let mirror = Vector3::new(-1.0, 1.0, 1.0);
            stretch_about_its_stand(&mut mirrored, &mirror);
            let q: Vec<f64> = (0..plain.joints.len()).map(|i| 0.3 + 0.2 * i as f64).collect();
            for (a, b) in plain.joints.iter().zip(&mirrored.joints) {
                let seen = plain.world_from_part(&q)[a.child] * a.grasp;
                let in_mirror = mirrored.world_from_part(&q)[b.child] * b.grasp;
                assert!((in_mirror.coords - seen.coords.component_mul(&mirror)).norm() < 1e-9);
            }
        }
    }
}
