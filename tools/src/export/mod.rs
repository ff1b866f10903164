//! Learned objects as robot descriptions that simulators and planners read.
//!
//! The frame of a description has the object frame's origin and z up; every link's frame has its
//! axes, and its origin on the joint that moves the link. At configuration 0 the links are where the
//! demonstration began. `description.rs` makes links and joints of the model, with boxes that
//! `upright.rs` sets up and `clearance.rs` keeps apart; one file each writes a format.

mod clearance;
mod colour;
mod cuboid;
mod description;
mod fitted_boxes;
mod fused_surface;
mod gap;
mod joint;
mod json;
mod main_surface;
mod manifold;
mod mesh;
mod mjcf;
mod names;
mod overlap;
mod patch;
mod sdf;
mod seen_carrier;
mod solid_cells;
mod surface_nets;
mod upright;
mod urdf;
mod usd;
mod xml;

pub use description::Description;
pub use json::json;
pub use mjcf::mjcf;
pub use sdf::sdf;
pub use urdf::urdf;
pub use usd::usd;

#[cfg(test)]
mod tests {
    use super::clearance::{chain, moved};
    use super::overlap::overlap;
    use super::*;
    use linkage_planner_bridge::{JointMechanics, ObjectMechanics, Rig};
    use linkage_skill::internals::Surfel;
    use linkage_skill::object::{
        Appearance, Joint, JointGeometry, JointKind, MODEL_SCHEMA, Part, ReferenceFrame,
        StoredObject,
    };
    use linkage_skill::{ObjectModel, Pose};
    use nalgebra::{Point3, Vector3};

    /// Pieces of surface over a rectangle, 2 cm apart; places in a camera's frame, y down.
    fn rectangle(part: u16, corner: [f64; 3], sides: [[f64; 3]; 2]) -> Vec<Surfel> {
        let [a, b] = sides.map(Vector3::from);
        let normal = a.cross(&b).normalize().map(|x| x as f32).into();
        let steps = |side: &Vector3<f64>| (side.norm() / 0.02) as usize;
        let places = (0..=steps(&a)).flat_map(|i| (0..=steps(&b)).map(move |k| (i, k)));
        let at = |(i, k): (usize, usize)| {
            let place = Vector3::from(corner)
                + a.normalize() * (0.02 * i as f64)
                + b.normalize() * (0.02 * k as f64);
            Surfel { part, point: place.map(|x| x as f32).into(), normal, lab: [60.0, 10.0, 20.0] }
        };
        places.map(at).collect()
    }

    /// The six faces of a block, seen from outside.
    fn block(part: u16, low: [f64; 3], high: [f64; 3]) -> Vec<Surfel> {
        let [x, y, z] = [0, 1, 2].map(|k| high[k] - low[k]);
        let ([a, b, c], [d, e, f]) = (low, high);
        let faces = [
            (low, [[0.0, y, 0.0], [x, 0.0, 0.0]]),
            ([a, b, f], [[x, 0.0, 0.0], [0.0, y, 0.0]]),
            (low, [[x, 0.0, 0.0], [0.0, 0.0, z]]),
            ([a, e, c], [[0.0, 0.0, z], [x, 0.0, 0.0]]),
            (low, [[0.0, 0.0, z], [0.0, y, 0.0]]),
            ([d, b, c], [[0.0, y, 0.0], [0.0, 0.0, z]]),
        ];
        faces.into_iter().flat_map(|(corner, sides)| rectangle(part, corner, sides)).collect()
    }

    fn object(joints: Vec<Joint>, surfels: Vec<Surfel>) -> StoredObject {
        let model = ObjectModel {
            schema: MODEL_SCHEMA.to_owned(),
            object: "cup & board".to_owned(),
            reference_frame: ReferenceFrame::at_camera(0.0),
            parts: (0..=joints.len()).map(|i| Part::new(i, format!("part{i}"), 9)).collect(),
            joints,
            demonstrations: 1,
            profile: "default".to_owned(),
            version: "0".to_owned(),
        };
        let appearance = Appearance { surfels, ..Appearance::default() };
        StoredObject { model, appearance, provenance: Vec::new() }
    }

    fn joint(number: usize, parent: usize, line: &JointGeometry, range: [f64; 2]) -> Joint {
        let name = format!("joint{number}");
        Joint { name, parent, child: number, range, ..Joint::of(line) }
    }

    /// A cupboard of 60 cm by 80 cm by 40 cm with a door before its left half, that carries a latch
    /// nobody saw, and a drawer in its right half; a metre before the camera.
    fn cupboard() -> StoredObject {
        let hinge = JointGeometry::hinge(Vector3::y_axis(), Point3::new(-0.3, 0.0, 1.0));
        let latch = JointGeometry::slide(Vector3::x_axis(), Point3::new(-0.1, 0.0, 1.0));
        let slide = JointGeometry::slide(-Vector3::z_axis(), Point3::new(0.15, 0.0, 1.0));
        let joints = vec![
            joint(1, 0, &hinge, [0.0, 1.5]),
            joint(2, 1, &latch, [-0.05, 0.0]),
            joint(3, 0, &slide, [0.0, 0.3]),
        ];
        let surfels = [
            block(0, [-0.3, -0.4, 1.01], [0.3, 0.4, 1.4]),
            block(1, [-0.3, -0.38, 0.98], [0.01, 0.38, 1.0]),
            block(3, [0.0, -0.2, 0.98], [0.28, 0.2, 1.35]),
        ];
        object(joints, surfels.concat())
    }

    fn described(object: &StoredObject) -> Description {
        Description::new(object, &Rig::default()).unwrap()
    }

    /// The deepest overlap of any two links at any of this many configurations of each joint,
    /// metres.
    fn deepest_overlap(of: &Description, steps: usize) -> f64 {
        let grids: Vec<Vec<f64>> = of.joints.iter().map(|j| j.configurations(steps)).collect();
        let mut deepest: f64 = 0.0;
        for number in 0..grids.iter().map(Vec::len).product() {
            let mut left = number;
            let mut configuration = Vec::new();
            for grid in &grids {
                configuration.push(grid[left % grid.len()]);
                left /= grid.len();
            }
            let placed: Vec<Vec<_>> = (0..of.links.len())
                .map(|link| {
                    let path = chain(link, &of.joints);
                    let number = |j: &super::joint::Hinge| {
                        of.joints.iter().position(|other| other.name == j.name).unwrap()
                    };
                    let motion = path.iter().rev().fold(Pose::identity(), |motion, j| {
                        motion * j.line.motion(configuration[number(j)])
                    });
                    let origin = of.links[link].origin.coords;
                    let to_world = motion * Pose::translation(origin.x, origin.y, origin.z);
                    of.links[link].boxes.iter().map(|b| moved(b, &to_world)).collect()
                })
                .collect();
            for (i, a) in placed.iter().enumerate() {
                for b in placed[i + 1..].iter().flatten() {
                    let depths = a.iter().filter_map(|a| overlap(a, b)).map(|(depth, _)| depth);
                    deepest = depths.fold(deepest, f64::max);
                }
            }
        }
        deepest
    }

    #[test]
    fn parts_keep_their_distance_wherever_the_joints_stand() {
        let description = described(&cupboard());
        let deepest = deepest_overlap(&description, 9);
        assert!(deepest < 0.005, "{deepest} m");
        let base: f64 = description.links[0].boxes.iter().map(|b| b.volume()).sum();
        assert!(base > 0.5 * 0.6 * 0.8 * 0.39 - 0.03, "little is left of the base: {base} m3");
    }

    #[test]
    fn boxes_lie_along_their_joints_and_stand_upright() {
        let description = described(&cupboard());
        // The latch's way cuts the door into several boxes.
        let size = |link: usize| {
            let boxes = &description.links[link].boxes;
            let corners = boxes.iter().flat_map(|b| b.corners());
            let own: Vec<_> = corners.map(|c| boxes[0].rotation.inverse() * c.coords).collect();
            let high = own.iter().skip(1).fold(own[0], |a, b| a.sup(b));
            high - own.iter().skip(1).fold(own[0], |a, b| a.inf(b))
        };
        let sorted = |mut sides: Vec<f64>| {
            sides.sort_by(f64::total_cmp);
            sides
        };
        for (link, wanted) in [(1, [0.02, 0.31, 0.76]), (3, [0.28, 0.37, 0.4])] {
            let sides = sorted(size(link).iter().copied().collect());
            let close = sides.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 0.025);
            assert!(close, "link {link}: {sides:?}");
        }
        assert!((Vector3::from(description.joints[0].axis()) + Vector3::z()).norm() < 1e-6);
        assert!((Vector3::from(description.joints[2].axis()) - Vector3::x()).norm() < 1e-6);
    }

    #[test]
    fn a_part_that_was_not_seen_has_a_shape_and_a_mass_at_its_joint() {
        let description = described(&cupboard());
        let latch = &description.links[2];
        assert_eq!([1, 2, 3].map(|link| description.links[link].is_seen), [true, false, true]);
        assert_eq!(latch.boxes.len(), 1);
        assert!(latch.inertia.mass_kg >= 0.05 && latch.inertia.moments[(0, 0)] > 0.0);
        assert!(latch.boxes[0].center.coords.norm() < 1e-9, "{}", latch.boxes[0].center);
    }

    #[test]
    fn a_reader_of_urdf_finds_the_joints_where_they_were_learned() {
        let description = described(&cupboard());
        let robot = urdf_rs::read_from_string(&urdf(&description).unwrap()).unwrap();
        assert_eq!((robot.name.as_str(), robot.links.len()), ("cup & board", 5));
        assert_eq!(robot.joints[0].parent.link, "world");
        for (read, written) in robot.joints[1..].iter().zip(&description.joints) {
            let at = description.in_parent(written);
            assert!((at - Vector3::from(*read.origin.xyz)).norm() < 1e-8, "{}", written.name);
            assert_eq!(*read.axis.xyz, written.axis());
            assert_eq!([read.limit.lower, read.limit.upper], written.range);
            assert_eq!(read.child.link, description.links[written.child].name);
        }
        assert_eq!(robot.joints[1].limit.velocity, Rig::default().revolute.velocity);
        assert!(matches!(robot.joints[1].joint_type, urdf_rs::JointType::Revolute));
        assert!(matches!(robot.joints[3].joint_type, urdf_rs::JointType::Prismatic));
    }

    #[test]
    fn mjcf_nests_what_moves_with_what_and_sdf_places_every_link() {
        let description = described(&cupboard());
        let text = mjcf(&description).unwrap();
        let place = |what: &str| text.find(what).unwrap_or_else(|| panic!("{what} in {text}"));
        let order =
            ["body name=\"part0\"", "body name=\"part1\"", "body name=\"part2\"", "</body>"];
        assert!(order.windows(2).all(|w| place(w[0]) < place(w[1])), "{text}");
        assert!(text.contains("type=\"slide\"") && text.contains("model=\"cup &amp; board\""));
        assert!(text.contains("<exclude body1=\"part0\" body2=\"part1\"/>"), "{text}");
        let text = sdf(&description).unwrap();
        let at = description.links[1].origin;
        assert!(
            text.contains(&format!(
                "<pose>{} 0 0 0</pose>",
                super::xml::spaced(at.iter().copied())
            ))
        );
    }

    #[test]
    fn little_of_a_base_is_told() {
        assert_eq!(described(&cupboard()).little_of_base(), None);
        let mut hardly_seen = cupboard();
        let is_seen = |s: &Surfel| s.part != 0 || s.point[0] < -0.25 && s.point[1] < -0.3;
        hardly_seen.appearance.surfels.retain(is_seen);
        assert!(described(&hardly_seen).little_of_base().is_some_and(|share| share < 0.1));
    }

    #[test]
    fn parts_that_are_in_each_others_way_do_not_touch_in_mjcf() {
        let mut description = described(&cupboard());
        assert!(description.overlapping().is_empty(), "they were trimmed");
        let (door, drawer) = (description.boxes_at(1, 0.5), description.boxes_at(3, 0.5));
        description.links[3].boxes[0].center += door[0].center - drawer[0].center;
        assert!(description.overlapping().contains(&[1, 3]));
        let text = mjcf(&description).unwrap();
        assert!(text.contains("<exclude body1=\"part1\" body2=\"part3\"/>"), "{text}");
    }

    #[test]
    fn names_that_a_format_keeps_for_itself_are_changed() {
        let mut object = cupboard();
        object.model.parts[1].name = "world".to_owned();
        object.model.joints[0].name = "world_".to_owned();
        let description = described(&object);
        let text = urdf(&description).unwrap();
        assert!(text.contains("link name=\"world_\"") && text.contains("joint name=\"world__2\""));
        assert!(sdf(&description).unwrap().contains("<child>world_</child>"));
    }

    #[test]
    fn what_the_rig_gives_of_a_joint_reaches_every_format_and_is_no_guess() {
        let object = cupboard();
        let given =
            JointMechanics { effort: Some(41.25), damping: Some(0.625), friction: Some(0.375) };
        let own = ObjectMechanics { revolute: given, ..ObjectMechanics::default() };
        let mut rig = Rig::default();
        rig.mechanics.objects.insert(object.model.object.clone(), own);
        let of_rig = |rig: &Rig| Description::new(&object, rig).unwrap();
        let (given, guessed) = (of_rig(&rig), of_rig(&Rig::default()));
        for (format, write, wanted) in [
            ("urdf", urdf as fn(&Description) -> anyhow::Result<String>, 1.0),
            ("sdf", sdf, 1.0),
            ("mjcf", mjcf, 1.0),
            ("usd", usd, std::f64::consts::PI / 180.0),
        ] {
            let text = write(&given).unwrap();
            let damping = format!("{:.6}", 0.625 * wanted);
            for value in ["41.25", damping.trim_end_matches('0'), "0.375"] {
                assert!(text.contains(value), "{format}: {value} in {text}");
            }
            assert!(text.contains("The rig gives effort, damping, friction of hinges"), "{text}");
            let text = write(&guessed).unwrap();
            assert!(text.contains("Efforts, damping and friction are guesses."), "{text}");
        }
        let model = serde_json::to_value(json(&object.model, &rig)).unwrap();
        let [door, drawer] = [0, 2].map(|joint| &model["mechanics"][joint]);
        assert_eq!(door["effort"], 41.25);
        assert_eq!(door["guessed"], serde_json::json!([]));
        assert_eq!(drawer["guessed"], serde_json::json!(["effort", "damping", "friction"]));
        let read: ObjectModel = serde_json::from_value(model).unwrap();
        assert_eq!(read.joints.len(), 3, "it is read as a model");
    }

    #[test]
    fn a_screw_is_written_where_the_format_has_screws_and_refused_by_name_elsewhere() {
        let mut object = cupboard();
        object.model.joints[1].kind = JointKind::Helical;
        object.model.joints[1].pitch = 0.09;
        let description = described(&object);
        let text = sdf(&description).unwrap();
        for wanted in ["version=\"1.10\"", "type=\"screw\"", "<screw_thread_pitch>0.09<"] {
            assert!(text.contains(wanted), "{wanted} in {text}");
        }
        for refused in [urdf(&description), mjcf(&description), usd(&description)] {
            assert!(refused.unwrap_err().to_string().contains("joint2 is helical"));
        }
    }

    #[test]
    fn a_joint_that_no_format_can_hold_is_refused_by_name() {
        let mut object = cupboard();
        object.model.joints[1].kind = JointKind::Nonparametric;
        let refused = Description::new(&object, &Rig::default()).err().unwrap().to_string();
        assert!(refused.contains("joint2 is nonparametric"), "{refused}");
    }
}
