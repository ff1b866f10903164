//! Things on a desk, a stool, and a bicycle.

use super::kit::{
    BASE, BLUE, DARK, GREY, Look, Palette, WHITE, WOOD, cuboid, hinge, part, scene_of, slide,
    there_and_back,
};
use super::world::{Part, Scene, SceneJoint, Solid};
use linkage_skill::object::JointKind;
use nalgebra::Point3;

/// Height of the desk, metres.
pub const TABLE: f64 = 0.75;

/// A printer whose paper tray is pulled out.
pub fn printer_tray(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, tray, inside) = (p.paint(WHITE), p.paint(GREY), p.paint(WOOD));
    let mut s = scene_of("printer", "prismatic", [0.0, -0.1, TABLE + 0.08], [-16.0, 26.0, 1.0]);
    s.parts = vec![
        part("body", vec![cuboid([0.0, 0.0, TABLE + 0.12], [0.44, 0.36, 0.24], &body, BASE)]),
        part(
            "tray",
            vec![
                cuboid([0.0, -0.19, TABLE + 0.05], [0.36, 0.02, 0.08], &tray, 2),
                cuboid([0.0, -0.05, TABLE + 0.03], [0.32, 0.26, 0.01], &inside, 2),
                cuboid([0.0, -0.05, TABLE + 0.05], [0.22, 0.24, 0.02], &inside, 2),
            ],
        ),
    ];
    s.joints = vec![slide("tray", [0.0, -1.0, 0.0], [0.05, -0.20, TABLE + 0.05], [0.7, -1.0, 0.3])];
    s.actions = there_and_back(0, 0.18, 1.3, 2.2).into();
    s
}

/// The same with a scanner's lid, which is lifted.
pub fn printer_lid(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (body, lid, glass) = (p.paint(GREY), p.paint(WHITE), p.paint(BLUE));
    let top = TABLE + 0.18;
    let mut s = scene_of("scanner", "revolute", [0.0, 0.0, top], [-14.0, 30.0, 1.05]);
    s.parts = vec![
        part(
            "body",
            vec![
                cuboid([0.0, 0.0, TABLE + 0.088], [0.46, 0.36, 0.176], &body, BASE),
                cuboid([0.0, -0.01, top - 0.002], [0.36, 0.26, 0.004], &glass, BASE),
            ],
        ),
        part("lid", vec![cuboid([0.0, 0.0, top + 0.017], [0.46, 0.36, 0.03], &lid, 2)]),
    ];
    s.joints = vec![hinge(
        "lid",
        [1.0, 0.0, 0.0],
        [0.0, 0.18, top + 0.01],
        [0.08, -0.18, top + 0.02],
        [0.8, -0.8, 0.25],
    )];
    s.actions = there_and_back(0, -1.2, 1.3, 2.5).into();
    s
}

/// A screen on a foot, tilted about a level axis.
pub fn screen(look: Look) -> Scene {
    let mut s = screen_on_foot(look);
    s.joints = vec![hinge(
        "panel",
        [1.0, 0.0, 0.0],
        [0.0, 0.03, TABLE + 0.24],
        [0.24, -0.01, TABLE + 0.48],
        [0.8, -0.7, 0.3],
    )];
    s.actions = there_and_back(0, 0.5, 1.3, 2.0).into();
    s
}

/// The same turned about an upright axis.
pub fn screen_turned(look: Look) -> Scene {
    let mut s = screen_on_foot(look);
    s.joints = vec![hinge(
        "panel",
        [0.0, 0.0, 1.0],
        [0.0, 0.03, TABLE + 0.24],
        [0.27, -0.01, TABLE + 0.30],
        [0.8, -0.7, 0.3],
    )];
    s.actions = there_and_back(0, -0.7, 1.3, 2.2).into();
    s
}

fn screen_on_foot(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (foot, panel) = (p.paint(GREY), p.paint(BLUE));
    let mut s = scene_of("screen", "revolute", [0.0, 0.0, TABLE + 0.26], [-18.0, 14.0, 1.15]);
    s.parts = vec![
        part(
            "foot",
            vec![
                cuboid([0.0, -0.02, TABLE + 0.012], [0.34, 0.26, 0.024], &foot, BASE),
                cuboid([0.0, 0.05, TABLE + 0.14], [0.08, 0.04, 0.24], &foot, BASE),
            ],
        ),
        part("panel", vec![cuboid([0.0, 0.005, TABLE + 0.32], [0.54, 0.035, 0.34], &panel, 2)]),
    ];
    s
}

/// A monitor that turns on its foot and tilts on its post.
pub fn monitor(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (foot, table, panel) = (p.paint(GREY), p.paint(WOOD), p.paint(BLUE));
    let mut s = scene_of("monitor", "monitor", [0.0, -0.02, TABLE + 0.25], [-16.0, 22.0, 1.15]);
    s.parts = vec![
        part("foot", vec![cuboid([0.0, -0.02, TABLE + 0.015], [0.56, 0.36, 0.03], &foot, BASE)]),
        part(
            "turntable",
            vec![
                cuboid([0.0, -0.03, TABLE + 0.048], [0.36, 0.28, 0.03], &table, 2),
                cuboid([0.0, 0.07, TABLE + 0.18], [0.12, 0.05, 0.24], &table, 2),
            ],
        ),
        part("panel", vec![cuboid([0.0, 0.025, TABLE + 0.36], [0.52, 0.035, 0.32], &panel, 3)]),
    ];
    s.joints = vec![
        hinge(
            "turntable",
            [0.0, 0.0, 1.0],
            [0.0, 0.0, TABLE + 0.04],
            [0.25, 0.0, TABLE + 0.30],
            [0.8, -0.7, 0.3],
        ),
        SceneJoint {
            parent: 1,
            child: 2,
            ..hinge(
                "panel",
                [1.0, 0.0, 0.0],
                [0.0, 0.05, TABLE + 0.28],
                [0.22, 0.02, TABLE + 0.52],
                [0.8, -0.7, 0.4],
            )
        },
    ];
    s.actions = there_and_back(0, -0.6, 1.3, 1.9).into();
    s.actions.extend(there_and_back(1, 0.45, 7.6, 1.7));
    s.duration = 13.0;
    s
}

/// A stool whose seat is screwed up and down.
pub fn stool(look: Look) -> Scene {
    let mut p = Palette::new(look);
    let (foot, seat, metal) = (p.paint(WOOD), p.paint(BLUE), p.paint(DARK));
    let mut s = scene_of("stool", "helical", [0.0, 0.0, 0.40], [12.0, 30.0, 1.35]);
    let up = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
    let leg =
        |x: f64, y: f64| Solid::rod(up(2.2 * x, 2.2 * y, 0.0), up(x, y, 0.36), 0.022, &foot, BASE);
    let mut base: Vec<Solid> =
        [(0.1, 0.1), (0.1, -0.1), (-0.1, 0.1), (-0.1, -0.1)].map(|(x, y)| leg(x, y)).into();
    base.push(Solid::drum(up(0.0, 0.0, 0.34), up(0.0, 0.0, 0.38), 0.15, &foot, BASE));
    s.parts = vec![
        part("foot", base),
        part(
            "seat",
            vec![
                Solid::rod(up(0.0, 0.0, 0.36), up(0.0, 0.0, 0.47), 0.02, &metal, 2),
                Solid::drum(up(0.0, 0.0, 0.47), up(0.0, 0.0, 0.52), 0.19, &seat, 2),
                cuboid([0.0, 0.15, 0.56], [0.26, 0.04, 0.10], &seat, 2),
            ],
        ),
    ];
    s.joints = vec![SceneJoint {
        kind: JointKind::Helical,
        pitch: 0.09,
        ..hinge("seat", [0.0, 0.0, 1.0], [0.0, 0.0, 0.4], [0.17, -0.06, 0.50], [0.9, -0.8, 0.3])
    }];
    s.actions = there_and_back(0, 1.3, 1.3, 3.5).into();
    s.duration = 11.0;
    s
}

/// A bicycle on a stand: its fork is steered, its crank and its rear wheel are turned.
pub fn bicycle(look: Look) -> Scene {
    let mut s = scene_of("bicycle", "bicycle", [0.0, 0.0, 0.52], [-12.0, 12.0, 2.1]);
    s.parts = bicycle_parts(look);
    s.joints = vec![
        hinge(
            "fork",
            [-0.28, 0.0, 1.0],
            [-0.41, 0.0, 0.80],
            [-0.38, -0.24, 0.97],
            [-0.8, -0.8, 0.3],
        ),
        SceneJoint {
            child: 2,
            ..hinge(
                "crank",
                [0.0, 1.0, 0.0],
                [-0.02, 0.0, 0.30],
                [0.15, -0.19, 0.31],
                [0.6, -1.0, 0.4],
            )
        },
        SceneJoint {
            child: 3,
            ..hinge("wheel", [0.0, 1.0, 0.0], REAR_HUB, [0.62, -0.03, 0.58], [0.8, -0.8, 0.3])
        },
    ];
    s.actions = there_and_back(0, 0.55, 1.2, 1.5).into();
    s.actions.extend(there_and_back(1, 0.9, 6.8, 1.4));
    s.actions.extend(there_and_back(2, 0.7, 12.2, 1.4));
    s.duration = 17.0;
    s
}

/// Middle of the bicycle's rear wheel.
const REAR_HUB: [f64; 3] = [0.50, 0.0, 0.32];

/// The bicycle's frame, fork, crank and rear wheel.
fn bicycle_parts(look: Look) -> Vec<Part> {
    let mut p = Palette::new(look);
    let (frame, bag, wheel, metal, basket) =
        (p.paint(BLUE), p.paint(WOOD), p.paint(GREY), p.paint(DARK), p.paint(WHITE));
    let tube = |a: [f64; 3], b: [f64; 3], label| {
        Solid::rod(Point3::from(a), Point3::from(b), 0.025, &frame, label)
    };
    let disc = |c: [f64; 3], radius: f64, y: f64, half: f64, m, label| {
        let face = |side: f64| Point3::new(c[0], y + side * half, c[2]);
        Solid::drum(face(-1.0), face(1.0), radius, m, label)
    };
    vec![
        part(
            "frame",
            vec![
                tube([-0.40, 0.0, 0.80], [-0.02, 0.06, 0.30], BASE),
                tube([-0.38, 0.0, 0.78], [0.14, 0.0, 0.78], BASE),
                tube([0.18, 0.0, 0.92], [-0.02, 0.06, 0.30], BASE),
                tube([-0.02, 0.06, 0.30], [0.50, 0.06, 0.32], BASE),
                cuboid([-0.08, 0.0, 0.62], [0.26, 0.07, 0.22], &bag, BASE),
                cuboid([0.20, 0.0, 0.95], [0.26, 0.14, 0.06], &bag, BASE),
            ],
        ),
        part(
            "fork",
            vec![
                disc([-0.55, 0.0, 0.32], 0.30, 0.0, 0.02, &wheel, 2),
                tube([-0.55, -0.05, 0.32], [-0.43, -0.05, 0.75], 2),
                tube([-0.41, 0.0, 0.80], [-0.38, 0.0, 0.95], 2),
                tube([-0.38, -0.26, 0.97], [-0.38, 0.26, 0.97], 2),
                cuboid([-0.56, 0.0, 0.86], [0.22, 0.28, 0.20], &basket, 2),
            ],
        ),
        part(
            "crank",
            vec![
                disc([-0.02, 0.0, 0.30], 0.11, -0.07, 0.008, &metal, 3),
                Solid::rod(
                    Point3::new(-0.19, -0.10, 0.30),
                    Point3::new(0.15, -0.10, 0.30),
                    0.014,
                    &metal,
                    3,
                ),
                cuboid([0.15, -0.15, 0.30], [0.09, 0.08, 0.03], &bag, 3),
            ],
        ),
        part("wheel", vec![disc(REAR_HUB, 0.30, 0.0, 0.02, &wheel, 4)]),
    ]
}
