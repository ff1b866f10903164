//! A moving part's boxes give way to the surface that was seen of what carries it.
//!
//! Some of what was learned of a part is not of it: a strip of the frame that it uncovers. A box round
//! all of it then passes through the frame, and the frame would be cut away. But a part never was where
//! the surface of its carrier was seen. So a side of a box is moved inwards where that keeps clear of
//! much of the carrier's surface and leaves out little of the part's own.

use super::cuboid::Cuboid;
use super::joint::Hinge;
use linkage_skill::Pose;
use nalgebra::Vector3;

/// Configurations of a joint at which the part is held against its carrier.
const COMPARED: usize = 17;
/// How deep a place of the carrier may lie in a box: depth, poses and lines are not better known. In a
/// board thinner than twice that nothing is deep. Metres.
const MARGIN_M: f64 = 0.01;
/// Most of a side's length that is taken off in one go.
const LARGEST_TRIM: f64 = 0.25;
/// Largest share of the part's places in a box that a cut leaves out.
const LARGEST_LOSS: f64 = 0.1;
/// Fewest places of the carrier that a cut keeps clear of.
const LEAST_SAVED: usize = 15;
/// Places of the part that one of the carrier outweighs: of a frame round a part little is seen.
const OUTWEIGHED: usize = 5;
/// Depths that are tried at each side of a box.
const DEPTHS: usize = 12;

/// A place of the carrier where a box passes: for each configuration, its place in the box's own axes.
type Passed = Vec<Vector3<f64>>;

/// The boxes of a part, kept clear of its carrier's surface where that costs little. All in the export's
/// frame at configuration 0; `moved_by` is the joint between the two.
pub fn give_way(
    boxes: &[Cuboid],
    own: &[Vector3<f64>],
    carrier: &[Vector3<f64>],
    moved_by: &Hinge,
) -> Vec<Cuboid> {
    let motions: Vec<Pose> =
        moved_by.configurations(COMPARED).iter().map(|q| moved_by.line.motion(*q)).collect();
    boxes.iter().map(|shape| trimmed(shape.clone(), own, carrier, &motions)).collect()
}

fn trimmed(
    mut shape: Cuboid,
    own: &[Vector3<f64>],
    carrier: &[Vector3<f64>],
    motions: &[Pose],
) -> Cuboid {
    let own: Vec<Vector3<f64>> = own.iter().map(|p| in_axes_of(&shape, p)).collect();
    let passed: Vec<Passed> = carrier.iter().map(|place| passing(&shape, place, motions)).collect();
    let least_kept = own.iter().filter(|p| is_within(&shape, p, 0.0)).count() as f64;
    let least_kept = ((1.0 - LARGEST_LOSS) * least_kept).ceil() as usize;
    // Each side once or twice: a cut makes others needless.
    for _ in 0..6 {
        let within = own.iter().filter(|p| is_within(&shape, p, 0.0)).count();
        let may_lose = within.saturating_sub(least_kept);
        let Some(cut) = best_cut(&shape, &own, &passed, may_lose) else { break };
        shape = cut;
    }
    shape
}

/// The box with the side moved inwards that is most worth it.
fn best_cut(
    shape: &Cuboid,
    own: &[Vector3<f64>],
    passed: &[Passed],
    may_lose: usize,
) -> Option<Cuboid> {
    let count_own = |shape: &Cuboid| own.iter().filter(|p| is_within(shape, p, 0.0)).count();
    let is_in = |shape: &Cuboid, place: &Passed, margin_m: f64| {
        place.iter().any(|p| is_within(shape, p, margin_m))
    };
    let deep: Vec<&Passed> = passed.iter().filter(|p| is_in(shape, p, MARGIN_M)).collect();
    if deep.len() < LEAST_SAVED {
        return None;
    }
    let own_now = count_own(shape);
    let cuts =
        (0..6).flat_map(|side| (1..=DEPTHS).map(move |i| (side, i))).filter_map(|(side, i)| {
            let share = LARGEST_TRIM * i as f64 / DEPTHS as f64;
            let cut = without_slice(shape, side / 2, side % 2 == 0, share);
            let lost = own_now - count_own(&cut);
            if lost > may_lose {
                return None;
            }
            let saved = deep.iter().filter(|p| !is_in(&cut, p, 0.0)).count();
            let is_worth_it = saved >= LEAST_SAVED && OUTWEIGHED * saved > lost;
            is_worth_it.then(|| (OUTWEIGHED * saved - lost, cut))
        });
    // The first of equals: the least depth.
    cuts.reduce(|best, cut| if cut.0 > best.0 { cut } else { best }).map(|(_, cut)| cut)
}

/// Where a place of the carrier lies in the axes of a box that moves, at each configuration at which it
/// is within.
fn passing(shape: &Cuboid, place: &Vector3<f64>, motions: &[Pose]) -> Passed {
    let seen_by_part =
        motions.iter().map(|motion| motion.inverse_transform_point(&(*place).into()));
    let own = seen_by_part.map(|p| in_axes_of(shape, &p.coords));
    own.filter(|p| is_within(shape, p, 0.0)).collect()
}

fn in_axes_of(shape: &Cuboid, place: &Vector3<f64>) -> Vector3<f64> {
    shape.rotation.inverse() * place
}

/// True where a place in the box's own axes lies deeper in it than a margin.
fn is_within(shape: &Cuboid, place: &Vector3<f64>, margin_m: f64) -> bool {
    let (low, high) = shape.corners_along_sides();
    (0..3).all(|k| place[k] >= low[k] + margin_m && place[k] <= high[k] - margin_m)
}

/// A box without a slice at its upper or lower end along an axis, a share of its length thick.
fn without_slice(shape: &Cuboid, axis: usize, is_upper: bool, share: f64) -> Cuboid {
    let (mut low, mut high) = shape.corners_along_sides();
    let depth_m = share * (high[axis] - low[axis]);
    if is_upper {
        high[axis] -= depth_m;
    } else {
        low[axis] += depth_m;
    }
    Cuboid::between(low, high, shape.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_planner_bridge::Rig;
    use linkage_skill::object::{Joint, JointGeometry};
    use nalgebra::{Point3, UnitQuaternion};

    /// Places of a rectangle that stands across x, 2 cm apart: at `x`, over y and z.
    fn plate(x: f64, y: [f64; 2], z: [f64; 2]) -> Vec<Vector3<f64>> {
        let steps = |[low, high]: [f64; 2]| ((high - low) / 0.02).round() as usize;
        let all = (0..=steps(y)).flat_map(|i| (0..=steps(z)).map(move |k| (i, k)));
        let at = |(i, k)| Vector3::new(x, y[0] + 0.02 * f64::from(i), z[0] + 0.02 * f64::from(k));
        all.map(|(i, k)| at((i as u32, k as u32))).collect()
    }

    /// A sash of 40 cm by 40 cm that is pushed up by 30 cm.
    fn sash() -> (Vec<Vector3<f64>>, Hinge) {
        let line = JointGeometry::slide(Vector3::z_axis(), Point3::origin());
        let joint = Joint { range: [0.0, 0.3], ..Joint::of(&line) };
        let hinge = Hinge::new(&joint, "window", &Pose::identity(), &Rig::default()).unwrap();
        (plate(0.0, [0.0, 0.4], [0.0, 0.4]), hinge)
    }

    /// The box round places, 6 cm thick.
    fn around(places: &[Vector3<f64>]) -> Cuboid {
        let mut shape = Cuboid::around(places, UnitQuaternion::identity()).unwrap();
        shape.size.x = 0.06;
        shape
    }

    #[test]
    fn a_sash_to_which_a_strip_of_the_pane_behind_was_counted_leaves_the_head_of_its_frame() {
        let (sash, joint) = sash();
        // A strip of few places that its motion uncovers, and the frame's head that it would pass.
        let strip = plate(-0.02, [0.0, 0.4], [0.46, 0.48]);
        let own = [sash.clone(), strip].concat();
        let head = plate(0.0, [0.0, 0.4], [0.72, 0.78]);
        let before = around(&own);
        assert!(before.corners().iter().any(|c| c.z > 0.45), "the strip is in its box");
        let [after] = give_way(&[before], &own, &head, &joint).try_into().unwrap();
        let (low, high) = after.corners_along_sides();
        assert!(high.z + 0.3 < 0.72 + MARGIN_M && high.z > 0.38, "{high}");
        assert!(low.z < 0.01, "nothing is in the way below: {low}");
    }

    #[test]
    fn a_box_that_passes_nothing_or_holds_mostly_its_own_stays() {
        let (sash, joint) = sash();
        let shape = around(&sash);
        let beside = plate(0.0, [0.45, 0.6], [0.0, 0.8]);
        let stays = |carrier: &[Vector3<f64>]| {
            give_way(std::slice::from_ref(&shape), &sash, carrier, &joint) == [shape.clone()]
        };
        assert!(stays(&beside));
        assert!(stays(&[]));
        // A rail that was wrongly seen where half of the sash is.
        assert!(stays(&plate(0.0, [0.0, 0.4], [0.1, 0.3])));
    }
}
