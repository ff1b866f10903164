//! Furniture that is opened: doors, drawers, lids, a chair; and the rooms that it stands in.
//!
//! World frame: x right, y away from the viewer, z up; metres. Each part is described where it is at
//! configuration 0.

use super::devices;
use super::kit::{
    BASE, BLUE, DARK, GREY, Look, Palette, WHITE, WOOD, cuboid, hinge, part, scene_of, shell,
    slide, there_and_back,
};
use super::texture::{Richness, Texture};
use super::world::{Action, Material, Part, Scene, SceneJoint, Solid};
use linkage_skill::object::JointKind;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// A room's door in its frame.
pub fn door(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (frame, leaf, metal) = (p.paint(WOOD), p.paint(WHITE), p.paint(DARK));
    let mut s = scene_of("door", "revolute", [0.0, 0.0, 1.05], [-14.0, 8.0, 2.3]);
    s.parts = vec![
        part(
            "frame",
            vec![
                cuboid([-0.47, 0.0, 1.0], [0.12, 0.14, 2.0], &frame, BASE),
                cuboid([0.47, 0.0, 1.0], [0.12, 0.14, 2.0], &frame, BASE),
                cuboid([0.0, 0.0, 2.05], [1.06, 0.14, 0.12], &frame, BASE),
                cuboid([-1.1, 0.05, 1.0], [1.14, 0.06, 2.2], &frame, BASE),
                cuboid([1.1, 0.05, 1.0], [1.14, 0.06, 2.2], &frame, BASE),
            ],
        ),
        part(
            "leaf",
            vec![
                cuboid([0.0, -0.02, 1.0], [0.80, 0.04, 1.96], &leaf, 2),
                Solid::rod(
                    Point3::new(0.33, -0.09, 1.02),
                    Point3::new(0.24, -0.09, 1.02),
                    0.012,
                    &metal,
                    2,
                ),
            ],
        ),
    ];
    s.joints = vec![hinge(
        "leaf",
        [0.0, 0.0, 1.0],
        [-0.40, -0.04, 1.0],
        [0.28, -0.10, 1.02],
        [0.5, -1.0, 0.2],
    )];
    s.actions = there_and_back(0, -1.1, 1.4, 3.0).into();
    s
}

/// Two things of one make, this far apart.
pub fn twins(one: Scene, apart: f64) -> Scene {
    let mut both =
        Scene { parts: Vec::new(), joints: Vec::new(), actions: Vec::new(), ..one.clone() };
    for (number, side) in [-0.5, 0.5].into_iter().enumerate() {
        let aside = Vector3::x() * side * apart;
        let (first_part, first_joint) = (both.parts.len(), both.joints.len());
        let named = |name: &str| format!("{name}_{}", number + 1);
        both.parts.extend(one.parts.iter().map(|p| Part {
            name: named(&p.name),
            solids: p.solids.iter().map(|s| s.clone().shifted(&aside)).collect(),
        }));
        both.joints.extend(one.joints.iter().map(|j| SceneJoint {
            name: named(&j.name),
            parent: first_part + j.parent,
            child: first_part + j.child,
            origin: j.origin + aside,
            grasp: j.grasp + aside,
            ..j.clone()
        }));
        let later = one.duration * number as f64;
        both.actions.extend(one.actions.iter().map(|a| Action {
            joint: first_joint + a.joint,
            start: a.start + later,
            end: a.end + later,
            ..*a
        }));
    }
    both.duration = 2.0 * one.duration;
    both.view[2] += apart;
    both
}

/// A door on hinges that lift it as it opens, so that it falls shut.
pub fn rising_door(look: Look) -> Scene {
    let mut s = door(look);
    s.category = "helical";
    s.joints[0].kind = JointKind::Helical;
    s.joints[0].pitch = -0.11;
    s
}

/// A chest of two drawers, of which this many can be pulled.
pub fn drawers(look: Look, count: usize) -> Scene {
    let mut p = Palette::new(look);
    let (body, metal) = (p.paint(WOOD), p.paint(DARK));
    let category = if count == 1 { "prismatic" } else { "prismatic2" };
    let mut s = scene_of("drawer", category, [0.0, -0.1, 0.55], [-22.0, 26.0, 1.35]);
    let (w, d, h) = (0.50, 0.45, 0.66);
    let mut base = shell([0.0, 0.0, 0.45], [w, d, h], 0.02, &body, BASE);
    base.push(cuboid([0.0, 0.0, 0.45], [w, d, 0.02], &body, BASE));
    s.parts = vec![part("body", base)];
    for i in 0..2 {
        let z = if i == 0 { 0.61 } else { 0.29 };
        let label = 2 + i as u8;
        let (front, inside) = (p.paint(WHITE), p.paint(GREY));
        let y = -0.5 * d;
        let mut solids = vec![
            cuboid([0.0, y - 0.01, z], [w - 0.01, 0.02, 0.30], &front, label),
            cuboid([0.0, y + 0.20, z - 0.11], [w - 0.08, 0.38, 0.012], &inside, label),
            cuboid([-0.21, y + 0.20, z - 0.03], [0.012, 0.38, 0.16], &inside, label),
            cuboid([0.21, y + 0.20, z - 0.03], [0.012, 0.38, 0.16], &inside, label),
            Solid::rod(
                Point3::new(-0.07, y - 0.05, z),
                Point3::new(0.07, y - 0.05, z),
                0.009,
                &metal,
                label,
            ),
        ];
        if i < count {
            let part_name = if i == 0 { "upper" } else { "lower" };
            s.parts.push(part(part_name, solids));
            s.joints.push(SceneJoint {
                child: i + 1,
                ..slide(part_name, [0.0, -1.0, 0.0], [0.0, y - 0.06, z], [0.55, -1.0, 0.35])
            });
        } else {
            solids.iter_mut().for_each(|s| s.label = BASE);
            s.parts[0].solids.extend(solids);
        }
    }
    s.actions = there_and_back(0, 0.30, 1.3, if count == 1 { 2.8 } else { 1.7 }).into();
    if count == 2 {
        s.actions.extend(there_and_back(1, 0.28, 7.4, 1.7));
        s.duration = 13.0;
    }
    s
}

/// A fridge with things in it.
pub fn fridge(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, front, inside, metal) =
        (p.paint(WHITE), p.paint(WHITE), p.paint(BLUE), p.paint(DARK));
    let mut s = scene_of("fridge", "revolute", [0.05, -0.2, 0.95], [-24.0, 12.0, 2.0]);
    let mut base = shell([0.0, 0.0, 0.85], [0.60, 0.58, 1.5], 0.04, &body, BASE);
    for z in [0.5, 0.85, 1.2] {
        base.push(cuboid([0.0, 0.05, z], [0.52, 0.44, 0.015], &inside, BASE));
    }
    base.push(cuboid([-0.12, 0.0, 0.93], [0.10, 0.10, 0.15], &inside, BASE));
    base.push(cuboid([0.12, -0.05, 0.97], [0.14, 0.12, 0.22], &inside, BASE));
    s.parts = vec![
        part("body", base),
        part(
            "door",
            vec![
                cuboid([0.0, -0.32, 0.85], [0.60, 0.05, 1.48], &front, 2),
                cuboid([0.0, -0.27, 0.70], [0.46, 0.05, 0.05], &inside, 2),
                cuboid([0.0, -0.27, 1.10], [0.46, 0.05, 0.05], &inside, 2),
                Solid::rod(
                    Point3::new(-0.25, -0.37, 0.85),
                    Point3::new(-0.25, -0.37, 1.15),
                    0.012,
                    &metal,
                    2,
                ),
            ],
        ),
    ];
    s.joints = vec![hinge(
        "door",
        [0.0, 0.0, 1.0],
        [0.29, -0.31, 0.85],
        [-0.25, -0.38, 1.0],
        [-0.6, -1.0, 0.2],
    )];
    s.actions = there_and_back(0, 1.25, 1.3, 3.0).into();
    s
}

/// A microwave.
pub fn microwave(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, front, inside, metal) =
        (p.paint(GREY), p.paint(DARK), p.paint(WHITE), p.paint(WHITE));
    let mut s = scene_of("microwave", "revolute", [0.0, -0.1, 1.0], [-18.0, 16.0, 1.15]);
    let mut base = shell([-0.06, 0.0, 1.0], [0.38, 0.36, 0.28], 0.02, &body, BASE);
    base.push(cuboid([0.19, 0.0, 1.0], [0.12, 0.36, 0.28], &body, BASE));
    base.push(cuboid([-0.06, 0.02, 0.93], [0.16, 0.16, 0.08], &inside, BASE));
    s.parts = vec![
        part("body", base),
        part(
            "door",
            vec![
                cuboid([-0.06, -0.195, 1.0], [0.38, 0.03, 0.28], &front, 2),
                Solid::rod(
                    Point3::new(0.10, -0.24, 0.93),
                    Point3::new(0.10, -0.24, 1.07),
                    0.008,
                    &metal,
                    2,
                ),
            ],
        ),
    ];
    s.joints = vec![hinge(
        "door",
        [0.0, 0.0, 1.0],
        [-0.245, -0.205, 1.0],
        [0.10, -0.25, 1.0],
        [0.6, -1.0, 0.2],
    )];
    s.actions = there_and_back(0, -1.4, 1.3, 2.6).into();
    s
}

/// A laptop.
pub fn laptop(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (base, screen) = (p.paint(GREY), p.paint(BLUE));
    let mut s = scene_of("laptop", "revolute", [0.0, 0.0, 0.82], [14.0, 32.0, 0.95]);
    s.parts = vec![
        part("keyboard", vec![cuboid([0.0, 0.0, 0.765], [0.36, 0.25, 0.022], &base, BASE)]),
        part("lid", vec![cuboid([0.0, 0.0, 0.783], [0.36, 0.25, 0.012], &screen, 2)]),
    ];
    s.joints = vec![hinge(
        "lid",
        [1.0, 0.0, 0.0],
        [0.0, 0.125, 0.777],
        [0.06, -0.13, 0.785],
        [0.8, -0.7, 0.25],
    )];
    // Lifting the front edge about the hinge at the back.
    s.actions = there_and_back(0, -1.55, 1.3, 2.6).into();
    s
}

/// A sideboard with a sliding door.
pub fn sliding_door(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, front, inside, metal) =
        (p.paint(WOOD), p.paint(WHITE), p.paint(GREY), p.paint(DARK));
    let mut s = scene_of("sliding_door", "prismatic", [0.0, -0.1, 0.85], [10.0, 14.0, 1.7]);
    let mut base = shell([0.0, 0.0, 0.85], [1.1, 0.4, 0.8], 0.025, &body, BASE);
    base.push(cuboid([0.0, 0.05, 0.85], [1.05, 0.30, 0.02], &inside, BASE));
    base.push(cuboid([0.27, -0.18, 0.85], [0.52, 0.02, 0.74], &front, BASE));
    base.push(cuboid([-0.30, 0.0, 0.95], [0.16, 0.14, 0.16], &inside, BASE));
    s.parts = vec![
        part("body", base),
        part(
            "panel",
            vec![
                cuboid([-0.26, -0.215, 0.85], [0.54, 0.02, 0.74], &front, 2),
                Solid::rod(
                    Point3::new(-0.05, -0.24, 0.80),
                    Point3::new(-0.05, -0.24, 0.90),
                    0.010,
                    &metal,
                    2,
                ),
            ],
        ),
    ];
    s.joints = vec![slide("panel", [1.0, 0.0, 0.0], [-0.05, -0.25, 0.85], [0.3, -1.0, 0.2])];
    s.actions = there_and_back(0, 0.45, 1.3, 2.8).into();
    s
}

/// A cabinet on the wall.
pub fn cabinet(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, front, inside, metal) = (p.paint(WOOD), p.paint(WOOD), p.paint(GREY), p.paint(DARK));
    let mut s = scene_of("cabinet", "revolute", [0.0, -0.1, 1.2], [-15.0, 4.0, 1.4]);
    let mut base = shell([0.0, 0.0, 1.2], [0.70, 0.32, 0.62], 0.02, &body, BASE);
    base.push(cuboid([0.0, 0.02, 1.2], [0.66, 0.26, 0.02], &inside, BASE));
    base.push(cuboid([0.0, 0.0, 1.2], [0.02, 0.30, 0.60], &body, BASE));
    base.push(cuboid([0.175, -0.17, 1.2], [0.34, 0.02, 0.60], &front, BASE));
    s.parts = vec![
        part("body", base),
        part(
            "door",
            vec![
                cuboid([-0.175, -0.17, 1.2], [0.34, 0.02, 0.60], &front, 2),
                Solid::rod(
                    Point3::new(-0.05, -0.20, 1.10),
                    Point3::new(-0.05, -0.20, 1.20),
                    0.008,
                    &metal,
                    2,
                ),
            ],
        ),
    ];
    s.joints = vec![hinge(
        "door",
        [0.0, 0.0, 1.0],
        [-0.345, -0.175, 1.2],
        [-0.05, -0.21, 1.15],
        [0.6, -1.0, -0.2],
    )];
    s.actions = there_and_back(0, -1.3, 1.3, 2.7).into();
    s
}

/// A chair whose seat turns and whose back tilts.
pub fn office_chair(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (foot, seat, back) = (p.paint(GREY), p.paint(BLUE), p.paint(WOOD));
    let mut s = scene_of("office_chair", "chair", [0.0, 0.0, 0.65], [20.0, 22.0, 1.7]);
    let mut base = vec![
        Solid::drum(Point3::new(0.0, 0.0, 0.08), Point3::new(0.0, 0.0, 0.40), 0.05, &foot, BASE),
        Solid::drum(Point3::new(0.0, 0.0, 0.02), Point3::new(0.0, 0.0, 0.06), 0.30, &foot, BASE),
    ];
    base.push(cuboid([0.0, 0.0, 0.07], [0.5, 0.08, 0.05], &foot, BASE));
    s.parts = vec![
        part("foot", base),
        part(
            "seat",
            vec![
                cuboid([0.0, 0.0, 0.46], [0.46, 0.46, 0.08], &seat, 2),
                cuboid([-0.26, 0.0, 0.60], [0.05, 0.30, 0.03], &back, 2),
                cuboid([0.26, 0.0, 0.60], [0.05, 0.30, 0.03], &back, 2),
                cuboid([-0.26, 0.0, 0.53], [0.03, 0.05, 0.14], &back, 2),
                cuboid([0.26, 0.0, 0.53], [0.03, 0.05, 0.14], &back, 2),
            ],
        ),
        part("back", vec![cuboid([0.0, 0.24, 0.80], [0.42, 0.05, 0.50], &back, 3)]),
    ];
    s.joints = vec![
        hinge("seat", [0.0, 0.0, 1.0], [0.0, 0.0, 0.46], [0.27, -0.14, 0.63], [0.9, -0.8, 0.3]),
        SceneJoint {
            parent: 1,
            child: 2,
            ..hinge(
                "back",
                [1.0, 0.0, 0.0],
                [0.0, 0.22, 0.54],
                [0.15, 0.22, 1.06],
                [0.9, -0.3, 0.4],
            )
        },
    ];
    s.actions = there_and_back(0, 0.75, 1.3, 2.0).into();
    s.actions.extend(there_and_back(1, -0.45, 8.0, 1.7));
    s.duration = 13.5;
    s
}

/// A drawer that is stuck.
pub fn hand_only(look: Look) -> Scene {
    let mut s = drawers(look, 1);
    s.category = "static";
    // The hand does all that it does at a drawer, but the drawer is stuck.
    for action in &mut s.actions {
        action.to = 0.0;
    }
    s
}

/// A chest with a lid.
pub fn lid_box(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, lid, inside) = (p.paint(WOOD), p.paint(BLUE), p.paint(GREY));
    let mut s = scene_of("lid_box", "revolute", [0.0, 0.0, 0.55], [-20.0, 30.0, 1.25]);
    s.parts = vec![
        part(
            "body",
            vec![
                cuboid([0.0, 0.0, 0.31], [0.5, 0.34, 0.02], &inside, BASE),
                cuboid([0.0, -0.16, 0.42], [0.5, 0.02, 0.24], &body, BASE),
                cuboid([0.0, 0.16, 0.42], [0.5, 0.02, 0.24], &body, BASE),
                cuboid([-0.24, 0.0, 0.42], [0.02, 0.34, 0.24], &body, BASE),
                cuboid([0.24, 0.0, 0.42], [0.02, 0.34, 0.24], &body, BASE),
            ],
        ),
        part("lid", vec![cuboid([0.0, 0.0, 0.555], [0.52, 0.36, 0.025], &lid, 2)]),
    ];
    s.joints = vec![hinge(
        "lid",
        [1.0, 0.0, 0.0],
        [0.0, 0.18, 0.545],
        [0.08, -0.19, 0.555],
        [0.8, -0.8, 0.25],
    )];
    s.actions = there_and_back(0, -1.25, 1.3, 2.6).into();
    s
}

/// Puts the object into a room: floor, wall, what it stands on, clutter. All from the seed.
pub fn furnish(scene: &mut Scene, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0f0f);
    let mut paint = |richness| {
        let colour = [0, 1, 2].map(|_| rng.random_range(70.0..210.0));
        Material {
            texture: Arc::new(Texture::new(colour, richness, rng.random())),
            depth_loss: 0.004,
        }
    };
    let wall_y = if scene.name == "door" { 2.6 } else { 0.55 };
    let mut solids = vec![
        cuboid([0.0, 0.0, -0.05], [8.0, 8.0, 0.1], &paint(Richness::Medium), 0),
        cuboid([0.0, wall_y + 0.05, 1.5], [8.0, 0.1, 3.0], &paint(Richness::Medium), 0),
    ];
    let stands = stand_of(scene);
    if let Some(top) = stands {
        let material = paint(Richness::Medium);
        solids.push(cuboid([0.0, 0.15, top - 0.02], [2.0, 0.8, 0.04], &material, 0));
    }
    let top = stands.unwrap_or(0.0);
    let mut place = ChaCha8Rng::seed_from_u64(seed ^ 0xc1a7);
    for side in [-1.0, 1.0] {
        for _ in 0..place.random_range(2..5) {
            let size = [0, 1, 2].map(|_| place.random_range(0.06..0.26));
            let beside = if scene.category == "bicycle" { 0.6 } else { 0.0 };
            let x = side * (beside + place.random_range(0.55..0.95));
            let y = place.random_range(-0.05..0.30);
            let material = paint(Richness::Rich);
            solids.push(cuboid([x, y, top + 0.5 * size[2]], size, &material, 0));
        }
    }
    scene.surroundings = solids;
}

/// Height of what an object stands on; `None` for the floor. Things that do not reach the
/// floor stand on a table, or hang on the wall above one.
pub fn stand_of(scene: &Scene) -> Option<f64> {
    let bottom = scene
        .parts
        .iter()
        .flat_map(|p| &p.solids)
        .map(|s| s.body_from_solid.translation.z)
        .fold(f64::INFINITY, f64::min);
    match scene.name.as_str() {
        "microwave" => Some(0.855),
        "laptop" | "two_laptops" => Some(0.75),
        "lid_box" => Some(0.295),
        "sliding_door" => Some(0.44),
        "drawer" | "two_drawers" | "hand_only" | "moving_camera" => Some(0.115),
        "printer" | "scanner" | "screen" | "monitor" => Some(devices::TABLE),
        _ if bottom > 1.0 => Some(0.72),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twins_are_moved_one_after_the_other() {
        let look = Look { name: "laptop", richness: Richness::Rich };
        let one = laptop(look);
        let both = twins(laptop(look), 0.5);
        assert_eq!((both.parts.len(), both.joints.len()), (4, 2));
        assert_eq!((both.joints[1].parent, both.joints[1].child), (2, 3));
        assert!(both.actions[2].start >= one.duration);
        assert!((both.joints[1].origin.x - both.joints[0].origin.x - 0.5).abs() < 1e-12);
    }
}
