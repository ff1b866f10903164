//! A learned object as links and joints, which all formats have in common.
//!
//! In: an object of the store (object frame at configuration 0, metres). Out: for each part a link,
//! with its origin on the joint that moves it, its boxes and its inertia; for each joint its line. The
//! export's frame has the object frame's origin, z up and x towards where the viewer stood; every
//! link's frame has its axes.

use super::clearance::{Body, chain, moved, shapes};
use super::colour::srgb;
use super::cuboid::{Cuboid, Inertia, LEAST_PLACES};
use super::fitted_boxes::fitted_boxes;
use super::joint::{Hinge, Motion};
use super::main_surface::main_surface;
use super::mesh::Mesh;
use super::overlap::{CLEARANCE_M, overlap};
use super::patch::Patch;
use super::upright::{box_rotation, world_from_object};
use anyhow::bail;
use linkage_planner_bridge::{JointMechanics, Rig};
use linkage_skill::Pose;
use linkage_skill::object::{Appearance, ObjectModel, Part, StoredObject};
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

/// Colour of a part that was not seen.
const UNSEEN_COLOUR: [f64; 3] = [0.5, 0.5, 0.5];

/// Overlap of two boxes that a simulator resolves without a jerk, metres.
const OVERLAP_M: f64 = 0.005;
/// Smallest volume of a base, as a share of its moving parts': frames of windows and doors have more.
const LITTLE_OF_BASE: f64 = 0.1;

/// An object as links and joints.
#[derive(Clone)]
pub struct Description {
    pub name: String,
    /// The root first.
    pub links: Vec<Link>,
    pub joints: Vec<Hinge>,
    /// Rotation of the export's frame from the object frame.
    pub world_from_object: UnitQuaternion<f64>,
}

/// A part; shapes are given in its own frame.
#[derive(Clone)]
pub struct Link {
    pub name: String,
    /// Of its frame, in the export's frame at configuration 0.
    pub origin: Point3<f64>,
    /// At least one.
    pub boxes: Vec<Cuboid>,
    pub inertia: Inertia,
    /// Enough of its surface was learned; else a small box stands for it.
    pub is_seen: bool,
    /// Red, green and blue, 0 to 1.
    pub colour: [f64; 3],
    /// The surface that was seen, where it is wanted.
    pub mesh: Option<Mesh>,
}

impl Description {
    /// Of a learned object; limits of its joints are the rig's.
    ///
    /// # Errors
    /// When a joint neither turns, slides nor screws, which the formats cannot hold.
    pub fn new(object: &StoredObject, rig: &Rig) -> anyhow::Result<Self> {
        let model = &object.model;
        let rotation = upright(model, &object.appearance);
        let to_world = Pose::from_parts(Translation3::identity(), rotation);
        let joints = model.joints.iter().map(|j| Hinge::new(j, &model.object, &to_world, rig));
        let joints = joints.collect::<anyhow::Result<Vec<Hinge>>>()?;
        let patches = patches(object, &to_world);
        let numbered = model.parts.iter().zip(&patches).enumerate();
        let bodies: Vec<Body> = numbered
            .map(|(number, (part, patches))| {
                let moved_by = joints.iter().find(|j| j.child == number);
                body(part, patches, moved_by, &to_world)
            })
            .collect();
        let parts = model.parts.iter().zip(&patches).zip(shapes(&bodies, &joints)).enumerate();
        let links = parts.map(|(number, ((part, patches), boxes))| {
            let moved_by = joints.iter().find(|j| j.child == number);
            link(part, patches, boxes, moved_by)
        });
        let links = links.collect();
        Ok(Self { name: model.object.clone(), links, joints, world_from_object: rotation })
    }

    /// The same with the surface of each part that was seen, in files of a folder with names of their
    /// own.
    pub fn with_meshes(mut self, object: &StoredObject, folder: &str) -> Self {
        let to_world = Pose::from_parts(Translation3::identity(), self.world_from_object);
        let patches = patches(object, &to_world);
        for (number, (link, patches)) in self.links.iter_mut().zip(&patches).enumerate() {
            let mesh = Mesh::fused(patches, &link.boxes[0], &link.origin);
            let file = format!("{folder}/part{number}.obj");
            link.mesh = mesh.map(|mesh| Mesh { file, ..mesh });
        }
        self
    }

    /// The volume of the base's boxes, as a share of that of all moving parts', where it is small: then the export does
    /// not look like the thing.
    pub fn little_of_base(&self) -> Option<f64> {
        let volume = |links: &[Link]| -> f64 {
            links.iter().flat_map(|l| &l.boxes).map(Cuboid::volume).sum()
        };
        let (base, moving) = self.links.split_first()?;
        let share = volume(std::slice::from_ref(base)) / volume(moving).max(1e-9);
        (share < LITTLE_OF_BASE).then_some(share)
    }

    /// Pairs of links that no joint joins, and whose boxes overlap at configuration 0, where a simulator begins, or
    /// while every joint is in the middle of its range: it would push them apart with force.
    pub fn overlapping(&self) -> Vec<[usize; 2]> {
        let mut pairs = [0.0, 0.5].map(|share| self.overlapping_at(share)).concat();
        pairs.sort_unstable();
        pairs.dedup();
        pairs
    }

    fn overlapping_at(&self, share: f64) -> Vec<[usize; 2]> {
        let boxes: Vec<Vec<Cuboid>> =
            (0..self.links.len()).map(|i| self.boxes_at(i, share)).collect();
        let is_joined = |[a, b]: [usize; 2]| {
            let holds = |j: &Hinge| [[a, b], [b, a]].contains(&[j.parent, j.child]);
            self.joints.iter().any(holds)
        };
        let deep = |a: &Cuboid, b: &Cuboid| {
            overlap(a, b).is_some_and(|(depth, _)| depth > CLEARANCE_M + OVERLAP_M)
        };
        let overlaps =
            |[a, b]: [usize; 2]| boxes[a].iter().any(|x| boxes[b].iter().any(|y| deep(x, y)));
        let pairs = (0..boxes.len()).flat_map(|a| (a + 1..boxes.len()).map(move |b| [a, b]));
        pairs.filter(|pair| !is_joined(*pair) && overlaps(*pair)).collect()
    }

    /// A link's boxes in the export's frame while every joint is at this share of its way from the configuration of its
    /// range that is next to 0 to the one that is farthest from it.
    pub fn boxes_at(&self, link: usize, share: f64) -> Vec<Cuboid> {
        let at_share = |joint: &&Hinge| {
            let [low, high] = joint.range;
            let end = if high.abs() >= low.abs() { high } else { low };
            let begin = 0_f64.clamp(low, high);
            joint.line.motion(begin + share * (end - begin))
        };
        let path = chain(link, &self.joints);
        let motion = path.iter().rev().map(at_share).fold(Pose::identity(), |all, next| all * next);
        let Link { boxes, origin, .. } = &self.links[link];
        let to_export = motion * Translation3::from(origin.coords);
        boxes.iter().map(|b| moved(b, &to_export)).collect()
    }

    /// Refuses screws for a format that has none.
    ///
    /// # Errors
    /// Names the first screw.
    pub fn without_screws(&self, format: &str) -> anyhow::Result<&Self> {
        match self.joints.iter().find(|j| j.is_screw()) {
            None => Ok(self),
            Some(joint) => bail!(
                "{} is helical, and {format} has no screws; use --format sdf or json",
                joint.name
            ),
        }
    }

    /// Where the joint is in its parent's frame.
    pub fn in_parent(&self, joint: &Hinge) -> Vector3<f64> {
        self.links[joint.child].origin - self.links[joint.parent].origin
    }

    /// What the head of every file says.
    pub fn remarks(&self) -> String {
        let q = self.world_from_object.quaternion();
        format!(
            "Learned by Linkage from RGB-D. Metres, radians, kilograms; z is up (as far as it was seen). \
             Rotation of this frame from the object frame, qx qy qz qw: {:.9} {:.9} {:.9} {:.9}. \
             Masses and inertias are guesses: 150 kg/m3 for boxes, as furniture is mostly hollow, 600 kg/m3 for boards, 0.05 kg at \
             least. {} Velocities are the rig's.",
            q.i,
            q.j,
            q.k,
            q.w,
            self.origin_of_mechanics()
        )
    }

    /// Which efforts, dampings and frictions are the rig's and which are guesses.
    fn origin_of_mechanics(&self) -> String {
        let given = [
            ("hinges and screws", self.joints.iter().find(|j| j.motion != Motion::Slides)),
            ("slides", self.joints.iter().find(|j| j.motion == Motion::Slides)),
        ];
        let told = given.into_iter().filter_map(|(kind, joint)| {
            let JointMechanics { effort, damping, friction } = joint?.given;
            let keys = [("effort", effort), ("damping", damping), ("friction", friction)];
            let keys = keys.iter().filter(|(_, value)| value.is_some()).map(|(key, _)| *key);
            let keys = keys.collect::<Vec<_>>().join(", ");
            (!keys.is_empty()).then(|| format!("The rig gives {keys} of {kind}. "))
        });
        let told: String = told.collect();
        match told.is_empty() {
            true => "Efforts, damping and friction are guesses.".to_owned(),
            false => told + "What of effort, damping and friction it does not give is a guess.",
        }
    }
}

/// The rotation that sets the object upright.
fn upright(model: &ObjectModel, appearance: &Appearance) -> UnitQuaternion<f64> {
    let normals = appearance.surfels.iter().map(|s| Vector3::from(s.normal).map(f64::from));
    let normals: Vec<Vector3<f64>> = normals.filter(is_direction).collect();
    let axes: Vec<Vector3<f64>> = model.joints.iter().map(|j| Vector3::from(j.axis)).collect();
    world_from_object(&normals, &axes)
}

fn is_direction(normal: &Vector3<f64>) -> bool {
    (normal.norm() - 1.0).abs() < 0.1
}

/// The surface of each part in the export's frame.
fn patches(object: &StoredObject, world_from_object: &Pose) -> Vec<Vec<Patch>> {
    let mut of_parts = vec![Vec::new(); object.model.parts.len()];
    for surfel in &object.appearance.surfels {
        let place = Point3::from(surfel.point).map(f64::from);
        let normal = Vector3::from(surfel.normal).map(f64::from);
        let Some(patches) = of_parts.get_mut(usize::from(surfel.part)) else { continue };
        if is_direction(&normal) && place.iter().all(|x| x.is_finite()) {
            let (place, normal) = ((world_from_object * place).coords, world_from_object * normal);
            patches.push(Patch { place, normal, lab: surfel.lab });
        }
    }
    let moving: Vec<Vec<Patch>> =
        of_parts.iter().skip(1).map(|patches| main_surface(patches, &[])).collect();
    let base = of_parts.first().map(|base| main_surface(base, &moving.concat()));
    base.into_iter().chain(moving).collect()
}

/// A part's boxes along the joint that moves it, upright for the base; a small one where it was held,
/// else at its joint, where its surface was not seen.
fn body(part: &Part, patches: &[Patch], moved_by: Option<&Hinge>, to_world: &Pose) -> Body {
    let places: Vec<Vector3<f64>> = patches.iter().map(|p| p.place).collect();
    let normals: Vec<Vector3<f64>> = patches.iter().map(|p| p.normal).collect();
    let rotation = match moved_by {
        None => UnitQuaternion::identity(),
        Some(joint) => box_rotation(&joint.line.axis, &normals, &places),
    };
    let unseen = || {
        let held = part.grasp.map(|held| to_world * Point3::from(held));
        let somewhere = || places.first().map(|p| Point3::from(*p));
        let at = held.or_else(somewhere).or(moved_by.map(|j| j.line.origin));
        Cuboid::unseen(at.unwrap_or_default(), rotation)
    };
    let shape = Cuboid::around(&places, rotation).unwrap_or_else(unseen);
    let mut boxes = fitted_boxes(&places, rotation);
    if boxes.is_empty() {
        boxes.push(shape.clone());
    }
    Body { shape, boxes, surface: places.into_iter().zip(normals).collect() }
}

/// A part with its origin on the joint that moves it.
fn link(part: &Part, patches: &[Patch], boxes: Vec<Cuboid>, moved_by: Option<&Hinge>) -> Link {
    let origin = moved_by.map_or(Point3::origin(), |j| j.line.origin);
    let boxes: Vec<Cuboid> = boxes.iter().map(|b| b.seen_from(&origin)).collect();
    let sum = patches.iter().map(|p| Vector3::from(p.lab)).sum::<Vector3<f32>>();
    let colour = match patches.len() {
        0 => UNSEEN_COLOUR,
        count => srgb((sum / count as f32).into()),
    };
    Link {
        name: part.name.clone(),
        origin,
        inertia: Inertia::of(&boxes),
        is_seen: patches.len() >= LEAST_PLACES,
        boxes,
        colour,
        mesh: None,
    }
}
