//! Collision shapes with clearance between them.
//!
//! In: the boxes of all parts at configuration 0, and the joints. Out: boxes that no configuration
//! within the ranges makes overlap. Boxes of parts that move beside each other are trimmed where they
//! touch. What carries a moving part, such as a cabinet its drawer, is the part of its own box that
//! lies behind the surface that was seen of it and that nothing passes through.

use super::cuboid::Cuboid;
use super::joint::Hinge;
use super::overlap::overlap;
use super::solid_cells::SolidCells;
use linkage_skill::Pose;
use nalgebra::Vector3;

/// Configurations of a joint at which a carrier is cut.
const CUTS: usize = 33;
/// Configurations of a joint at which neighbours are compared.
const COMPARED: usize = 9;
/// Most pairs of configurations that are compared for all pairs of parts.
const MOST_COMPARISONS: usize = 100_000;
/// Most boxes that a carrier is cut by.
const MOST_CUTS: usize = 4_000;
/// Most times that a pair is trimmed.
const TRIMS: usize = 12;
/// Parts of which a greater share would have to be trimmed do collide, as a drawer does into the
/// door before it.
const LARGEST_TRIM: f64 = 0.25;

/// A part in the export's frame at configuration 0.
pub struct Body {
    pub shape: Cuboid,
    /// Where its surface was seen, and the normals there.
    pub surface: Vec<(Vector3<f64>, Vector3<f64>)>,
}

/// The boxes of each part, in the export's frame at configuration 0.
pub fn shapes(bodies: &[Body], joints: &[Hinge]) -> Vec<Vec<Cuboid>> {
    let mut boxes: Vec<Cuboid> = bodies.iter().map(|b| b.shape.clone()).collect();
    trim_neighbours(&mut boxes, joints);
    let shape = |part: usize| {
        let passing = passing_through(part, &boxes, joints);
        let (own, surface) = (&boxes[part], &bodies[part].surface);
        match passing.is_empty() {
            true => vec![own.clone()],
            false => SolidCells::new(own, surface, &passing).into_boxes(own, &passing),
        }
    };
    (0..boxes.len()).map(shape).collect()
}

/// The joints from a part to the root, the one that moves the part first.
pub fn chain(part: usize, joints: &[Hinge]) -> Vec<&Hinge> {
    let moving = |part: usize| joints.iter().find(|j| j.child == part);
    let mut chain = Vec::new();
    let mut next = moving(part);
    while let Some(joint) = next.filter(|_| chain.len() < joints.len()) {
        chain.push(joint);
        next = moving(joint.parent);
    }
    chain
}

/// A box that was moved.
pub fn moved(shape: &Cuboid, by: &Pose) -> Cuboid {
    let (center, rotation) = (by * shape.center, by.rotation * shape.rotation);
    Cuboid { center, rotation, size: shape.size }
}

/// The boxes that each part takes which a part carries, from one end of its range to the other.
fn passing_through(carrier: usize, boxes: &[Cuboid], joints: &[Hinge]) -> Vec<Vec<Cuboid>> {
    let mut all = Vec::new();
    let mut left = MOST_CUTS;
    for (part, shape) in boxes.iter().enumerate() {
        let path = chain(part, joints);
        let Some(last) = path.iter().position(|j| j.parent == carrier) else { continue };
        let mut taken = motions(&path[..=last]);
        taken.truncate(left);
        left -= taken.len();
        all.push(taken.iter().map(|motion| moved(shape, motion)).collect());
    }
    all
}

/// How joints move the part at the end of them: all configurations of one, pairs of configurations of
/// the first and the last of several.
fn motions(path: &[&Hinge]) -> Vec<Pose> {
    match path {
        [] => vec![Pose::identity()],
        [only] => only.configurations(CUTS).iter().map(|q| only.line.motion(*q)).collect(),
        [first, .., last] => {
            let of_first = first.configurations(CUTS);
            let both = last.configurations(CUTS).into_iter().flat_map(|q| {
                let carried = last.line.motion(q);
                of_first.iter().map(move |p| carried * first.line.motion(*p))
            });
            both.collect()
        }
    }
}

/// Trims parts of which none carries the other so that they keep their distance.
fn trim_neighbours(boxes: &mut [Cuboid], joints: &[Hinge]) {
    let mut comparisons = 0;
    let carries = |part: usize, path: &[&Hinge]| path.iter().any(|j| j.parent == part);
    for a in 1..boxes.len() {
        for b in a + 1..boxes.len() {
            let (path_a, path_b) = (chain(a, joints), chain(b, joints));
            if carries(a, &path_b) || carries(b, &path_a) {
                continue;
            }
            for _ in 0..TRIMS {
                comparisons += COMPARED * COMPARED;
                if comparisons > MOST_COMPARISONS || !trim_pair(boxes, [a, b], [&path_a, &path_b]) {
                    break;
                }
            }
        }
    }
}

/// Trims whichever of two parts loses less; false where they keep their distance, or where much would
/// have to go.
fn trim_pair(boxes: &mut [Cuboid], parts: [usize; 2], paths: [&[&Hinge]; 2]) -> bool {
    let [of_a, of_b] = paths.map(|path| match path.first() {
        Some(joint) => {
            joint.configurations(COMPARED).iter().map(|q| joint.line.motion(*q)).collect()
        }
        None => vec![Pose::identity()],
    });
    let mut worst: Option<(f64, [Vector3<f64>; 2])> = None;
    for from_a in &of_a {
        let a = moved(&boxes[parts[0]], from_a);
        for from_b in &of_b {
            let Some((depth, normal)) = overlap(&a, &moved(&boxes[parts[1]], from_b)) else {
                continue;
            };
            if worst.as_ref().is_none_or(|w| depth > w.0) {
                let outward_a = from_a.rotation.inverse() * normal;
                worst = Some((depth, [outward_a, from_b.rotation.inverse() * -normal]));
            }
        }
    }
    let Some((depth, outward)) = worst else { return false };
    let slices = [0, 1].map(|i| Slice::new(&boxes[parts[i]], &outward[i], depth));
    let less = usize::from(slices[1].share < slices[0].share);
    if slices[less].share > LARGEST_TRIM {
        return false;
    }
    slices[less].take_off(&mut boxes[parts[less]]);
    true
}

/// A slice at the face of a box.
struct Slice {
    side: usize,
    depth_m: f64,
    sign: f64,
    /// Of the side's length.
    share: f64,
}

impl Slice {
    /// At the face that looks most in a direction.
    fn new(of: &Cuboid, outward: &Vector3<f64>, depth: f64) -> Self {
        let own = of.rotation.inverse() * outward;
        let side = own.iamax();
        let depth_m = depth / own[side].abs().max(0.5);
        Self { side, depth_m, sign: own[side].signum(), share: depth_m / of.size[side] }
    }

    fn take_off(&self, from: &mut Cuboid) {
        let mut inward = Vector3::zeros();
        inward[self.side] = -0.5 * self.depth_m * self.sign;
        from.size[self.side] -= self.depth_m;
        from.center += from.rotation * inward;
    }
}
