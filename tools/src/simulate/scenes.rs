//! The scenes: things that people open, and rooms to put them in.

use super::texture::{Richness, Texture};
use super::world::{Action, Material, Part, Scene, SceneJoint, Solid};
use super::{devices, instances};
use linkage_skill::object::joint_geometry::JointKind;
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

/// Names of all scenes, with what happens.
pub const SCENES: [(&str, &str); 20] = [
    ("door", "a room's door is opened and closed"),
    ("drawer", "a drawer is pulled and pushed"),
    ("two_drawers", "two drawers, one after the other"),
    ("fridge", "a fridge is opened and closed"),
    ("microwave", "a microwave is opened and closed"),
    ("laptop", "a laptop's lid is opened and closed"),
    ("sliding_door", "a sliding door is opened and closed"),
    ("cabinet", "a cabinet's door is opened and closed"),
    ("office_chair", "a chair's seat is turned, then its back is tilted"),
    ("hand_only", "a hand touches a thing that does not move"),
    ("moving_camera", "a drawer, watched by a camera held by hand"),
    ("lid_box", "the lid of a chest is opened and closed"),
    ("printer", "a printer's tray is pulled and pushed"),
    ("scanner", "the lid of a printer's scanner is opened and closed"),
    ("screen", "a screen is tilted"),
    ("monitor", "a monitor is turned, then tilted"),
    ("bicycle", "a bicycle is steered, pedalled, its wheel turned"),
    ("stool", "a stool's seat is screwed up and down"),
    ("rising_door", "a door that its hinges lift is opened and closed"),
    ("two_laptops", "two laptops of one make, one after the other"),
];

/// Which one of its sort an object is, and how much there is to see on it.
#[derive(Clone, Copy)]
pub struct Look<'n> {
    /// Its name: paints follow from it, not from the seed.
    pub name: &'n str,
    /// How much there is to see.
    pub richness: Richness,
}

/// Paints of one object.
pub struct Palette {
    seed: u64,
    richness: Richness,
}

impl Palette {
    /// Of an object.
    pub fn new(look: Look) -> Self {
        let seed = look.name.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| {
            (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3)
        });
        Self { seed, richness: look.richness }
    }

    /// The next paint.
    pub fn paint(&mut self, colour: [f64; 3]) -> Material {
        self.seed = self.seed.wrapping_add(1);
        Material {
            texture: Arc::new(Texture::new(colour, self.richness, self.seed)),
            depth_loss: 0.004,
        }
    }
}

/// A colour.
pub const WHITE: [f64; 3] = [205.0, 205.0, 200.0];
/// A colour.
pub const WOOD: [f64; 3] = [165.0, 120.0, 80.0];
/// A colour.
pub const GREY: [f64; 3] = [120.0, 122.0, 128.0];
/// A colour.
pub const DARK: [f64; 3] = [70.0, 72.0, 80.0];
/// A colour.
pub const BLUE: [f64; 3] = [90.0, 120.0, 170.0];

/// Label of the base; parts follow.
pub const BASE: u8 = 1;

pub fn part(name: &str, solids: Vec<Solid>) -> Part {
    Part { name: name.to_owned(), solids }
}

pub fn cuboid(c: [f64; 3], s: [f64; 3], m: &Material, label: u8) -> Solid {
    Solid::cuboid(c, s, m, label)
}

/// Open, hold a moment, close: two actions on one joint.
pub fn there_and_back(joint: usize, to: f64, start: f64, seconds: f64) -> [Action; 2] {
    let pause = 0.7;
    [
        Action { joint, to, start, end: start + seconds },
        Action {
            joint,
            to: 0.0,
            start: start + seconds + pause,
            end: start + 2.0 * seconds + pause,
        },
    ]
}

pub fn scene_of(name: &str, category: &'static str, target: [f64; 3], view: [f64; 3]) -> Scene {
    Scene {
        name: name.to_owned(),
        category,
        parts: Vec::new(),
        joints: Vec::new(),
        actions: Vec::new(),
        surroundings: Vec::new(),
        target: Point3::from(target),
        view,
        moving_camera: false,
        passer_by: false,
        duration: 10.0,
    }
}

pub fn hinge(
    name: &str,
    axis: [f64; 3],
    origin: [f64; 3],
    grasp: [f64; 3],
    person: [f64; 3],
) -> SceneJoint {
    SceneJoint {
        name: name.to_owned(),
        kind: JointKind::Revolute,
        parent: 0,
        child: 1,
        axis: Vector3::from(axis),
        origin: Point3::from(origin),
        pitch: 0.0,
        grasp: Point3::from(grasp),
        person: Vector3::from(person),
    }
}

pub fn slide(name: &str, axis: [f64; 3], grasp: [f64; 3], person: [f64; 3]) -> SceneJoint {
    SceneJoint { kind: JointKind::Prismatic, ..hinge(name, axis, grasp, grasp, person) }
}

/// A box with an open front: back, sides, floor, top.
fn shell(centre: [f64; 3], size: [f64; 3], wall: f64, m: &Material, label: u8) -> Vec<Solid> {
    let [x, y, z] = centre;
    let [w, d, h] = size;
    vec![
        cuboid([x, y + 0.5 * (d - wall), z], [w, wall, h], m, label),
        cuboid([x - 0.5 * (w - wall), y, z], [wall, d, h], m, label),
        cuboid([x + 0.5 * (w - wall), y, z], [wall, d, h], m, label),
        cuboid([x, y, z - 0.5 * (h - wall)], [w, d, wall], m, label),
        cuboid([x, y, z + 0.5 * (h - wall)], [w, d, wall], m, label),
    ]
}

/// Builds a scene in the room of a seed; `None` for an unknown name.
pub fn scene(name: &str, seed: u64) -> Option<Scene> {
    let Some(mut scene) = thing(name, name) else { return instances::demonstration(name) };
    furnish(&mut scene, seed);
    Some(scene)
}

/// A thing of the same shape with another surface; `None` for an unknown name.
pub fn repainted(name: &str, seed: u64) -> Option<Scene> {
    let mut scene = thing(name, &format!("another {name}"))?;
    furnish(&mut scene, seed);
    Some(scene)
}

/// A thing of the same surface with another shape; `None` for an unknown name.
pub fn reproportioned(name: &str, seed: u64) -> Option<Scene> {
    let mut scene = thing(name, name)?;
    instances::stretch_about_its_stand(&mut scene, &Vector3::new(1.35, 1.1, 0.75));
    furnish(&mut scene, seed);
    Some(scene)
}

/// The thing that a scene is about, painted after a name; no room yet.
fn thing(name: &str, painted_after: &str) -> Option<Scene> {
    let richness = match name {
        "cabinet" | "lid_box" => Richness::Medium,
        _ => Richness::Rich,
    };
    let look = Look { name: painted_after, richness };
    let mut scene = match name {
        "door" => door(look),
        "drawer" => drawers(look, 1),
        "two_drawers" => drawers(look, 2),
        "fridge" => fridge(look),
        "microwave" => microwave(look),
        "laptop" => laptop(look),
        "sliding_door" => sliding_door(look),
        "cabinet" => cabinet(look),
        "office_chair" => office_chair(look),
        "hand_only" => hand_only(look),
        "moving_camera" => Scene { moving_camera: true, ..drawers(look, 1) },
        "lid_box" => lid_box(look),
        "printer" => devices::printer_tray(look),
        "scanner" => devices::printer_lid(look),
        "screen" => devices::screen(look),
        "monitor" => devices::monitor(look),
        "bicycle" => devices::bicycle(look),
        "stool" => devices::stool(look),
        "rising_door" => rising_door(look),
        "two_laptops" => twins(thing("laptop", "laptop")?, 0.5),
        _ => return None,
    };
    scene.name = name.to_owned();
    Some(scene)
}

/// Things that are in every room of a household, each time elsewhere.
pub fn add_common_clutter(scene: &mut Scene, seed: u64) {
    let mut place = ChaCha8Rng::seed_from_u64(seed ^ 0x6e11);
    let top = stand_of(scene).unwrap_or(0.0);
    for (number, size) in
        [[0.22, 0.10, 0.28], [0.12, 0.12, 0.20], [0.28, 0.18, 0.09]].into_iter().enumerate()
    {
        let name = format!("clutter {number}");
        let paint = Palette::new(Look { name: &name, richness: Richness::Rich }).paint(WHITE);
        let side = if place.random_bool(0.5) { 1.0 } else { -1.0 };
        let x = side * place.random_range(0.6..1.0);
        let y = place.random_range(-0.15..0.3);
        scene.surroundings.push(cuboid([x, y, top + 0.5 * size[2]], size, &paint, 0));
    }
}

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
fn twins(one: Scene, apart: f64) -> Scene {
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
fn rising_door(look: Look) -> Scene {
    let mut s = door(look);
    s.category = "helical";
    s.joints[0].kind = JointKind::Helical;
    s.joints[0].pitch = -0.11;
    s
}

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

fn hand_only(look: Look) -> Scene {
    let mut s = drawers(look, 1);
    s.category = "static";
    // The hand does all that it does at a drawer, but the drawer is stuck.
    for action in &mut s.actions {
        action.to = 0.0;
    }
    s
}

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
