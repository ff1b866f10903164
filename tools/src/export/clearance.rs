//! Collision shapes with clearance between them.
//!
//! In: the boxes of all parts at configuration 0, and the joints. Out: boxes that no configuration
//! within the ranges makes overlap. Boxes of parts that move beside each other are trimmed where they
//! touch. What carries a moving part, such as a cabinet its drawer, is the part of its own box that
//! lies behind the surface that was seen of it and that nothing passes through.

use super::cuboid::Cuboid;
use super::joint::Hinge;
use super::overlap::overlap;
use super::seen_carrier::give_way;
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
    /// Round all of it.
    pub shape: Cuboid,
    /// Round its pieces, which take less room; at least one.
    pub boxes: Vec<Cuboid>,
    /// Where its surface was seen, and the normals there.
    pub surface: Vec<(Vector3<f64>, Vector3<f64>)>,
}

impl Body {
    fn places(&self) -> Vec<Vector3<f64>> {
        self.surface.iter().map(|(place, _)| *place).collect()
    }
}

/// The boxes of each part, in the export's frame at configuration 0.
pub fn shapes(bodies: &[Body], joints: &[Hinge]) -> Vec<Vec<Cuboid>> {
    let carries = |part: usize| joints.iter().any(|j| j.parent == part);
    let taken = |(part, body): (usize, &Body)| match carries(part) {
        // Of a carrier that is left which nothing passes through: its pieces are not known yet.
        true => vec![body.shape.clone()],
        false => body.boxes.clone(),
    };
    let mut boxes: Vec<Vec<Cuboid>> = bodies.iter().enumerate().map(taken).collect();
    for joint in joints.iter().filter(|j| !carries(j.child)) {
        let [own, carrier] = [joint.child, joint.parent].map(|part| bodies[part].places());
        boxes[joint.child] = give_way(&boxes[joint.child], &own, &carrier, joint);
    }
    trim_neighbours(&mut boxes, joints);
    let shape = |part: usize| {
        let passing = passing_through(part, &boxes, joints);
        match passing.is_empty() {
            true => boxes[part].clone(),
            false => {
                let own = &boxes[part][0];
                SolidCells::new(own, &bodies[part].surface, &passing).into_boxes(own, &passing)
            }
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
fn passing_through(carrier: usize, boxes: &[Vec<Cuboid>], joints: &[Hinge]) -> Vec<Vec<Cuboid>> {
    let mut all = Vec::new();
    let mut left = MOST_CUTS;
    for (part, pieces) in boxes.iter().enumerate() {
        let path = chain(part, joints);
        let Some(last) = path.iter().position(|j| j.parent == carrier) else { continue };
        let mut taken = motions(&path[..=last]);
        taken.truncate(left / pieces.len().max(1));
        left -= taken.len() * pieces.len();
        let at = |piece: &Cuboid| taken.iter().map(|motion| moved(piece, motion)).collect();
        all.extend(pieces.iter().map(at).collect::<Vec<Vec<Cuboid>>>());
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
fn trim_neighbours(boxes: &mut [Vec<Cuboid>], joints: &[Hinge]) {
    let mut comparisons = 0;
    let carries = |part: usize, path: &[&Hinge]| path.iter().any(|j| j.parent == part);
    for a in 1..boxes.len() {
        for b in a + 1..boxes.len() {
            let (path_a, path_b) = (chain(a, joints), chain(b, joints));
            if carries(a, &path_b) || carries(b, &path_a) {
                continue;
            }
            for _ in 0..TRIMS {
                comparisons += COMPARED * COMPARED * boxes[a].len() * boxes[b].len();
                if comparisons > MOST_COMPARISONS || !trim_pair(boxes, [a, b], [&path_a, &path_b]) {
                    break;
                }
            }
        }
    }
}

/// Trims whichever piece of two parts loses less; false where they keep their distance, or where much
/// would have to go.
fn trim_pair(boxes: &mut [Vec<Cuboid>], parts: [usize; 2], paths: [&[&Hinge]; 2]) -> bool {
    let [of_a, of_b] = paths.map(|path| match path.first() {
        Some(joint) => {
            joint.configurations(COMPARED).iter().map(|q| joint.line.motion(*q)).collect()
        }
        None => vec![Pose::identity()],
    });
    let Some(Touch { depth, pieces, outward }) =
        deepest_touch([&boxes[parts[0]], &boxes[parts[1]]], [&of_a, &of_b])
    else {
        return false;
    };
    let slice = |i: usize| Slice::new(&boxes[parts[i]][pieces[i]], &outward[i], depth);
    let slices = [slice(0), slice(1)];
    let less = usize::from(slices[1].share < slices[0].share);
    if slices[less].share > LARGEST_TRIM {
        return false;
    }
    slices[less].take_off(&mut boxes[parts[less]][pieces[less]]);
    true
}

/// Where two parts overlap.
struct Touch {
    depth: f64,
    /// The piece of either part.
    pieces: [usize; 2],
    /// Out of either part, in the export's frame at configuration 0.
    outward: [Vector3<f64>; 2],
}

/// The deepest overlap of two parts at any of these motions of them.
fn deepest_touch(boxes: [&[Cuboid]; 2], motions: [&[Pose]; 2]) -> Option<Touch> {
    let mut worst: Option<Touch> = None;
    for from_a in motions[0] {
        for (i, a) in boxes[0].iter().enumerate() {
            let a = moved(a, from_a);
            for from_b in motions[1] {
                for (k, b) in boxes[1].iter().enumerate() {
                    let Some((depth, normal)) = overlap(&a, &moved(b, from_b)) else { continue };
                    if worst.as_ref().is_none_or(|w| depth > w.depth) {
                        let outward_a = from_a.rotation.inverse() * normal;
                        let outward = [outward_a, from_b.rotation.inverse() * -normal];
                        worst = Some(Touch { depth, pieces: [i, k], outward });
                    }
                }
            }
        }
    }
    worst
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
