//! Verification: what of the object's surface should be visible is compared with what is, in
//! depth, in orientation and in appearance.

use super::edge_test::{Ends, KnownEdge, edges_of, ends};
use super::kinematics::{Articulated, State};
use super::scene::Scene;
use crate::math::extremes::smaller;
use crate::math::rigid::{Pose, matrix_pose};
use crate::object::appearance::Appearance;
use linkage_driver::depth::depth_tolerance;
use nalgebra::{Point3, Vector3};
use std::collections::HashMap;

/// An object's surface.
pub struct Cloud {
    /// Part, place and normal at configuration 0, colour.
    pub surfels: Vec<CloudPoint>,
    /// The patch of each surfel.
    patches: Vec<usize>,
    /// The part of each patch.
    part_of_patch: Vec<usize>,
    /// Where its parts are known to end; none of a thinned cloud.
    edges: Vec<KnownEdge>,
}

/// Surfels for which one stands in a thinned cloud.
const THINNING: usize = 3;

/// One surfel.
#[derive(Clone, Copy)]
pub struct CloudPoint {
    /// Part.
    pub part: usize,
    /// Place.
    pub point: Point3<f64>,
    /// Normal.
    pub normal: Vector3<f64>,
    /// L*a*b*.
    pub lab: [f32; 3],
}

impl Cloud {
    /// Unpacks an appearance.
    pub fn new(appearance: &Appearance) -> Self {
        let wide = |a: [f32; 3]| Vector3::from(a).map(f64::from);
        let surfels = appearance.surfels.iter().map(|s| CloudPoint {
            part: usize::from(s.part),
            point: Point3::from(wide(s.point)),
            normal: wide(s.normal),
            lab: s.lab,
        });
        Self { edges: edges_of(appearance), ..Self::of(surfels.collect()) }
    }

    /// Of surfels.
    pub fn of(surfels: Vec<CloudPoint>) -> Self {
        let mut part_of_patch = Vec::new();
        let mut in_cells: HashMap<_, Vec<Side>> = HashMap::new();
        let patch_of = |s: &CloudPoint| {
            let cell = [s.point.x, s.point.y, s.point.z].map(|x| (x / PATCH_M).floor() as i32);
            let sides = in_cells.entry((s.part, cell)).or_default();
            if let Some(side) = sides.iter().find(|side| side.normal.dot(&s.normal) > SAME_SIDE) {
                return side.patch;
            }
            let patch = part_of_patch.len();
            sides.push(Side { normal: s.normal, patch });
            part_of_patch.push(s.part);
            patch
        };
        let patches = surfels.iter().map(patch_of).collect();
        Self { patches, part_of_patch, surfels, edges: Vec::new() }
    }

    /// Every few surfels of each part: enough to compare configurations by.
    pub fn thinned(&self) -> Self {
        Self::of(self.surfels.iter().copied().step_by(THINNING).collect())
    }
}

/// A surfel placed in the picture, visible if nothing of the object hides it.
#[derive(Clone, Copy)]
pub struct Placed {
    /// Index in the cloud.
    pub index: usize,
    /// Part.
    pub part: usize,
    /// Place in the camera frame.
    pub point: Point3<f64>,
    /// Normal in the camera frame.
    pub normal: Vector3<f64>,
    /// Pixel.
    pub pixel: (usize, usize),
    /// Cosine between the normal and the direction to the camera.
    pub cosine: f64,
}

/// Nearer than this no depth camera sees, metres.
pub const NEAREST_M: f64 = 0.3;
/// Side of a cell of the coarse depth buffer that finds self-occlusion, pixels.
const BUFFER_PX: usize = 4;

/// A coarse depth buffer of the part of the picture that an object covers.
pub struct DepthBuffer {
    first: (usize, usize),
    columns: usize,
    parts: usize,
    /// By cell and part, the depth of the part's nearest surfel in the cell or those to its left
    /// and right; infinite where there is none.
    nearest: Vec<f32>,
}

impl DepthBuffer {
    /// Each surfel fills its cell and those about it.
    pub fn of(placed: &[Placed]) -> Self {
        let (mut first, mut last) = ((usize::MAX, usize::MAX), (1, 1));
        let mut parts = 0;
        for p in placed {
            let (u, v) = cell_of(p.pixel);
            first = (first.0.min(u), first.1.min(v));
            last = (last.0.max(u), last.1.max(v));
            parts = parts.max(p.part + 1);
        }
        // A cell of margin about them, for what is beside them.
        let first = (first.0.min(last.0) - 1, first.1.min(last.1) - 1);
        let (columns, rows) = (last.0 + 2 - first.0, last.1 + 2 - first.1);
        let mut nearest = vec![f32::INFINITY; columns * rows * parts];
        for p in placed {
            let (u, v) = cell_of(p.pixel);
            let cell = (v - first.1) * columns + u - first.0;
            for cell in cell - 1..=cell + 1 {
                let nearest = &mut nearest[cell * parts + p.part];
                *nearest = smaller(*nearest, p.point.z as f32);
            }
        }
        Self { first, columns, parts, nearest }
    }

    /// Depths of a part's nearest surfel at a pixel, and of that of any other part; infinite where
    /// there is none.
    pub fn nearest(&self, pixel: (usize, usize), part: usize) -> (f64, f64) {
        let (mut own, mut other) = (f32::INFINITY, f32::INFINITY);
        let (u, v) = cell_of(pixel);
        let column = u.checked_sub(self.first.0).filter(|column| *column < self.columns);
        for row in v - 1..=v + 1 {
            let Some((row, column)) = row.checked_sub(self.first.1).zip(column) else { continue };
            let from = (row * self.columns + column) * self.parts;
            let by_part = self.nearest.get(from..from + self.parts).unwrap_or(&[]);
            for (owner, z) in by_part.iter().enumerate() {
                let nearest = if owner == part { &mut own } else { &mut other };
                *nearest = smaller(*nearest, *z);
            }
        }
        (f64::from(own), f64::from(other))
    }
}

/// Counted from 1, so that each has neighbours.
fn cell_of(pixel: (usize, usize)) -> (usize, usize) {
    (pixel.0 / BUFFER_PX + 1, pixel.1 / BUFFER_PX + 1)
}

/// Surfels of a state that the camera should see. Where two parts claim one place, only the
/// nearer one counts: what is seen there is no evidence for the other.
pub fn visible(scene: &Scene, cloud: &Cloud, poses: &[Pose]) -> Vec<Placed> {
    let camera = &scene.frame.camera;
    let poses: Vec<_> = poses.iter().map(matrix_pose).collect();
    let mut placed = Vec::with_capacity(cloud.surfels.len());
    for (index, s) in cloud.surfels.iter().enumerate() {
        let pose = &poses[s.part];
        let point = pose * s.point;
        if point.z < NEAREST_M {
            continue;
        }
        let Some(pixel) = camera.project(&point).filter(|p| camera.sees(p, 2.0)) else { continue };
        let pixel = ((pixel.x + 0.5) as usize, (pixel.y + 0.5) as usize);
        let normal = pose * s.normal;
        let cosine = -normal.dot(&point.coords) / point.coords.norm();
        placed.push(Placed { index, part: s.part, point, normal, pixel, cosine });
    }
    let buffer = DepthBuffer::of(&placed);
    placed.retain(|p| {
        let slack = 0.03 + 0.02 * (1.0 - p.cosine.clamp(0.0, 1.0));
        let (own, other) = buffer.nearest(p.pixel, p.part);
        p.cosine > 0.2 && p.point.z <= own + slack && p.point.z <= other + 0.005
    });
    placed
}

/// What the picture says of one part.
#[derive(Debug, Clone, Copy, Default)]
pub struct PartVerdict {
    /// Surfels that agree in depth and normal.
    pub agree: usize,
    /// Surfels that are seen through.
    pub through: usize,
    /// Correlation of colour, -1 to 1; `None` with too little surface to tell.
    pub correlation: Option<f64>,
    /// How much the learned colour varies within patches, 0 to 1: how much a correlation says.
    pub texture: f64,
    /// What is beyond its edges.
    pub ends: Ends,
}

impl PartVerdict {
    /// The part's surface was seen where the state claims it, and it looks like it.
    pub fn is_seen(&self) -> bool {
        self.agree > 4 * self.through && self.looks_right()
    }

    /// The part's surface was seen where the state claims it, whatever it looks like.
    pub fn stands(&self) -> bool {
        self.agree >= LEAST_STANDING && self.agree > 4 * self.through
    }

    /// Share of its surface that is seen through, but for its edges.
    fn seen_through(&self) -> f64 {
        let through = self.through.saturating_sub(AT_EDGES) as f64;
        through / (self.agree as f64 + through).max(1.0)
    }

    /// Agreement in depth, in surfels: worth more where the surface also looks right and ends as
    /// learned. Surface that has texture and looks like another one speaks against the state: any
    /// plane agrees with any other in depth.
    pub fn fit(&self) -> f64 {
        let worth = self.correlation.map_or(PLAIN_WORTH, |correlation| {
            let looks = (correlation.max(0.0) - CHANCE) / (1.0 - CHANCE);
            PLAIN_WORTH + self.texture * (LIKE_WORTH * looks - PLAIN_WORTH)
        });
        let ends = self.ends.as_learned as f64 - self.ends.goes_on as f64;
        self.agree as f64 * worth + ends - 2.0 * self.through as f64
    }

    fn looks_right(&self) -> bool {
        self.agree >= LEAST_STANDING && self.looks_alike()
    }

    /// Most of what should be seen of it is seen through.
    pub fn is_gone(&self) -> bool {
        self.through.saturating_sub(AT_EDGES) > self.agree
    }

    /// Its texture is more likely another one.
    pub fn looks_other(&self) -> bool {
        self.otherness() > 0.5
    }

    /// 0 to 1: much of it is where it should be, and has texture, but another than was learned.
    fn otherness(&self) -> f64 {
        let ramp = |x: f64, (from, to): (f64, f64)| ((x - from) / (to - from)).clamp(0.0, 1.0);
        let unlike = self.correlation.map_or(0.0, |c| 1.0 - ramp(c, UNLIKE));
        ramp(self.agree as f64, MUCH) * self.texture * unlike
    }

    /// Its colour varies as it should.
    pub fn looks_alike(&self) -> bool {
        self.correlation.is_some_and(|c| c > 0.4)
    }
}

/// What the picture says of a state.
#[derive(Debug, Clone, Default)]
pub struct Verdict {
    /// Visible surfels at pixels with depth, not hidden by something in front.
    pub judged: usize,
    /// Of those, at the right depth.
    pub agree: usize,
    /// Of those, with the right normal.
    pub agree_normal: usize,
    /// Surfels in front of what is seen: nothing is there.
    pub through: usize,
    /// Surfels behind something else.
    pub hidden: usize,
    /// Correlation of colour, -1 to 1.
    pub correlation: f64,
    /// By part.
    pub parts: Vec<PartVerdict>,
}

/// What a surfel at its depth is worth whose looks tell nothing.
const PLAIN_WORTH: f64 = 0.4;
/// What one is worth whose surface looks just as learned.
const LIKE_WORTH: f64 = 1.6;
/// Correlation of colour that another surface has as often as the learned one in poor light.
const CHANCE: f64 = 0.3;
/// Surfels of a part that must be where a state claims them for the part to be there.
const LEAST_STANDING: usize = 25;
/// Surfels of the base that one counts for where it is seen through.
const SEEN_THROUGH: f64 = 5.0;
/// Share of a moving part's surface that is seen through where the part has another shape.
const ANOTHER_SHAPE: f64 = 0.1;
/// Surfels of a part from which its looks speak against it, and all they say.
const MUCH: (f64, f64) = (100.0, 300.0);
/// Correlations of a part that is another, and of one that may be the learned one in poor light.
const UNLIKE: (f64, f64) = (0.0, 0.25);
/// Surfels of a part that are seen through at its edges, whatever its shape.
const AT_EDGES: usize = 5;

impl Verdict {
    fn nothing_yet(parts: usize) -> Self {
        Self { parts: vec![PartVerdict::default(); parts], ..Self::default() }
    }

    /// 0 to 1: appearance times agreement in depth times free space and ends, less for little
    /// evidence.
    pub fn score(&self, inliers: usize) -> f64 {
        self.looks() * self.free_space() * self.ends() * self.agreement(inliers)
    }

    /// How much it looks like the object, 0 to 1. What moved is the object's own: however well
    /// the rest looks, a door of other paint is another door.
    pub fn looks(&self) -> f64 {
        let worst = self.parts.iter().skip(1).map(PartVerdict::otherness).fold(0.0, f64::max);
        self.correlation.max(0.0) * (1.0 - worst)
    }

    /// Less than 1 where the state claims surface that is seen through. Of the base that may be
    /// furniture; what moved is the object's own, and each part is judged by itself.
    pub fn free_space(&self) -> f64 {
        let of_base = self.parts.first().map_or(0, |p| p.through);
        let worth = if self.is_known() { 1.0 } else { SEEN_THROUGH };
        let base = worth * of_base as f64 / self.judged.max(1) as f64;
        let worst = self.parts.iter().skip(1).map(PartVerdict::seen_through).fold(0.0, f64::max);
        (1.0 - base - worst / ANOTHER_SHAPE).max(0.0)
    }

    /// Less than 1 where a part goes on beyond the edges of the learned one.
    pub fn ends(&self) -> f64 {
        let all = self.parts.iter().enumerate().map(|(i, part)| part.ends.likeness(i == 0));
        all.fold(1.0, f64::min)
    }

    /// Share of the surface that is where the state claims it, less where there is little of it
    /// or few matches.
    pub fn agreement(&self, inliers: usize) -> f64 {
        let gone = if self.is_known() { self.parts[0].through } else { 0 };
        self.agree as f64 / self.judged.saturating_sub(gone).max(1) as f64
            * (1.0 - (-(self.agree_normal as f64) / 200.0).exp())
            * (1.0 - (-(inliers as f64) / 3.0).exp())
    }

    /// Share of the surface that nothing else stands before.
    pub fn unhidden(&self) -> f64 {
        let forgiven = self.hidden.min(self.judged);
        self.judged as f64 / (self.judged + forgiven).max(1) as f64
    }

    /// Correlations of all and of each part, from what was compared of each patch.
    fn tell_looks(&mut self, cloud: &Cloud, looks: &[Looks]) {
        self.correlation = correlation(looks).unwrap_or(0.0);
        let of_parts = || cloud.part_of_patch.iter().zip(looks);
        for (number, part) in self.parts.iter_mut().enumerate() {
            let own: Vec<Looks> = of_parts().filter(|p| *p.0 == number).map(|p| *p.1).collect();
            part.correlation = correlation(&own);
            part.texture = texture(&own);
        }
    }

    /// 0 to 1: less where one side of every joint shows next to nothing, unless what moves is seen
    /// to end as learned. Else a surface is seen, and no more than that it may be this object's.
    pub fn mechanism(&self, articulated: &Articulated) -> f64 {
        let both_sides = (0..articulated.joints.len()).map(|joint| {
            let moved = articulated.moved_by(joint);
            let on = |side: bool| -> usize {
                let own = |(part, _): &(usize, &PartVerdict)| moved.contains(part) == side;
                self.parts.iter().enumerate().filter(own).map(|(_, p)| p.agree).sum()
            };
            on(true).min(on(false))
        });
        let ends: usize = self.parts.iter().skip(1).map(|part| part.ends.as_learned).sum();
        let evidence = both_sides.max().unwrap_or(0) as f64 / 10.0 + ends as f64 / 20.0;
        1.0 - 0.5 * (-evidence).exp()
    }

    /// Two parts look right, where the joints put them. What moved is the object's own, but of
    /// the base some may be furniture that stood beside it: the object is there without it.
    fn is_known(&self) -> bool {
        self.parts.split_first().is_some_and(|(base, rest)| {
            let moving = rest.iter().filter(|part| part.is_seen()).count();
            moving + usize::from(base.looks_right()) >= 2 && moving > 0
        })
    }

    /// [`PartVerdict::fit`] of all parts, for comparing configurations.
    pub fn fit(&self) -> f64 {
        self.parts.iter().map(PartVerdict::fit).sum()
    }
}

/// Compares a state with the picture.
pub fn verify(scene: &Scene, articulated: &Articulated, cloud: &Cloud, state: &State) -> Verdict {
    let poses = articulated.poses(state);
    let mut verdict = Verdict::nothing_yet(articulated.parts);
    let mut looks = vec![Looks::default(); cloud.part_of_patch.len()];
    let visible = visible(scene, cloud, &poses);
    if !cloud.edges.is_empty() {
        let buffer = DepthBuffer::of(&visible);
        let all = ends(scene, articulated, &cloud.edges, state, &buffer);
        verdict.parts.iter_mut().zip(all).for_each(|(part, ends)| part.ends = ends);
    }
    for p in visible {
        let (u, v) = p.pixel;
        let Some(z) = scene.frame.depth.at(u, v) else { continue };
        let tolerance = depth_tolerance(p.point.z, p.cosine);
        let behind = f64::from(z) - p.point.z;
        if behind > 2.0 * tolerance {
            if !is_beside(scene, &p, tolerance) {
                verdict.judged += 1;
                verdict.through += 1;
                verdict.parts[p.part].through += 1;
            }
            continue;
        }
        verdict.judged += 1;
        if behind < -tolerance {
            verdict.hidden += 1;
        } else if behind < tolerance {
            verdict.agree += 1;
            let cosine = scene.surface(u, v).map_or(0.0, |s| s.normal.dot(&p.normal));
            if cosine > 0.87 {
                verdict.agree_normal += 1;
                verdict.parts[p.part].agree += 1;
            }
            if cosine > 0.7 {
                let learned = cloud.surfels[p.index].lab;
                looks[cloud.patches[p.index]].add(learned, scene.lab.at(u, v));
            }
        }
    }
    // What stands before the object takes nothing away from it, up to a point.
    let half = verdict.judged / 2;
    verdict.judged -= verdict.hidden.min(half);
    verdict.tell_looks(cloud, &looks);
    verdict
}

/// So far beside its place, metres, an edge may be seen though its object is where the state says:
/// features tell a pose no better.
const BESIDE_M: f64 = 0.005;

/// Something as far away as a surfel should be is seen right beside it.
fn is_beside(scene: &Scene, p: &Placed, tolerance: f64) -> bool {
    let reach = (BESIDE_M * scene.frame.camera.fx / p.point.z).ceil() as isize;
    let (u, v) = p.pixel;
    let is_there = |du: isize, dv: isize| {
        let pixel = u.checked_add_signed(du).zip(v.checked_add_signed(dv));
        let z = pixel.and_then(|(u, v)| scene.frame.depth.at(u, v));
        z.is_some_and(|z| (f64::from(z) - p.point.z).abs() < tolerance)
    };
    let steps = [-reach, 0, reach];
    steps.iter().any(|&dv| steps.iter().any(|&du| is_there(du, dv)))
}

/// Compares a state's looks with a picture that has no depth: what stands before the object
/// counts against it.
pub fn verify_looks(
    scene: &Scene,
    articulated: &Articulated,
    cloud: &Cloud,
    state: &State,
) -> Verdict {
    let mut verdict = Verdict::nothing_yet(articulated.parts);
    let mut looks = vec![Looks::default(); cloud.part_of_patch.len()];
    for p in visible(scene, cloud, &articulated.poses(state)) {
        let learned = cloud.surfels[p.index].lab;
        looks[cloud.patches[p.index]].add(learned, scene.lab.at(p.pixel.0, p.pixel.1));
    }
    verdict.tell_looks(cloud, &looks);
    verdict
}

/// Side of a patch, a piece of a part's surface on which light falls evenly, metres. Two planks of
/// different paint are two levels of light, and any two levels correlate: only what varies
/// within a patch tells surfaces apart.
const PATCH_M: f64 = 0.1;
/// Least cosine between normals of one patch: around a corner light falls otherwise.
const SAME_SIDE: f64 = 0.7;

/// A patch and the normal of its first surfel.
struct Side {
    normal: Vector3<f64>,
    patch: usize,
}

/// Colour that varies so much, L*a*b*, tells a patch from others: any more counts no more.
const TELLING: f64 = 3.0;
/// Variation of colour that noise makes.
const NOISE: f64 = 1.0;
/// Fewest surfels of a patch that are compared.
const LEAST_IN_PATCH: f64 = 12.0;
/// Fewest surfels that tell anything.
const LEAST_IN_ALL: f64 = 25.0;

/// Learned and seen colours of a patch: sums over its surfels.
#[derive(Clone, Copy, Default)]
struct Looks {
    n: f64,
    learned: Vector3<f64>,
    seen: Vector3<f64>,
    learned_squared: f64,
    seen_squared: f64,
    common: f64,
}

impl Looks {
    fn add(&mut self, learned: [f32; 3], seen: [f32; 3]) {
        let [x, y] = [learned, seen].map(|lab| Vector3::from(lab).map(f64::from));
        self.n += 1.0;
        self.learned += x;
        self.seen += y;
        self.learned_squared += x.norm_squared();
        self.seen_squared += y.norm_squared();
        self.common += x.dot(&y);
    }

    /// Correlation, and how much it tells. The noise keeps plain surfaces from correlating by
    /// chance.
    fn alike(&self) -> (f64, f64) {
        let (mx, my) = (self.learned / self.n, self.seen / self.n);
        let xx = (self.learned_squared / self.n - mx.norm_squared()).max(0.0);
        let yy = (self.seen_squared / self.n - my.norm_squared()).max(0.0);
        let xy = self.common / self.n - mx.dot(&my);
        let weight = self.n * xx.min(TELLING * TELLING) / TELLING;
        (xy / ((xx + NOISE) * (yy + NOISE)).sqrt(), weight)
    }
}

/// How well colour varies alike within patches, -1 to 1: light differs between encounters,
/// texture does not. Each patch speaks for itself, however strong its contrast, so that one
/// mark upon another is no likeness. `None` for too little surface.
fn correlation(patches: &[Looks]) -> Option<f64> {
    let (mut sum, mut total, mut count) = (0.0, 0.0, 0.0);
    for patch in patches.iter().filter(|patch| patch.n >= LEAST_IN_PATCH) {
        let (alike, weight) = patch.alike();
        sum += weight * alike;
        total += weight;
        count += patch.n;
    }
    (count >= LEAST_IN_ALL && total > 0.0).then(|| sum / total)
}

/// How much learned colour varies within patches, 0 to 1.
fn texture(patches: &[Looks]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for patch in patches.iter().filter(|patch| patch.n >= LEAST_IN_PATCH) {
        sum += patch.alike().1 / TELLING;
        count += patch.n;
    }
    if count > 0.0 { sum / count } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use crate::test_data::{board, seen};

    fn part(agree: usize, through: usize) -> PartVerdict {
        PartVerdict { agree, through, correlation: Some(0.9), ..PartVerdict::default() }
    }

    fn verdict(parts: Vec<PartVerdict>) -> Verdict {
        let agree = parts.iter().map(|p| p.agree).sum();
        let through: usize = parts.iter().map(|p| p.through).sum();
        Verdict { judged: agree + through, agree, agree_normal: agree, parts, ..Verdict::default() }
    }

    #[test]
    fn a_moving_part_that_is_seen_through_has_another_shape() {
        let with_door = |through| verdict(vec![part(2000, 0), part(300, through)]).free_space();
        assert_eq!(with_door(AT_EDGES), 1.0);
        assert!(with_door(12) > 0.7);
        assert!(with_door(30) < 0.3);
        assert_eq!(with_door(60), 0.0);
    }

    /// Correlation of patches with learned colours and seen ones, by number.
    fn likeness(learned: fn(usize) -> [f32; 3], seen: fn(usize) -> [f32; 3]) -> f64 {
        let mut patch = Looks::default();
        (0..40).for_each(|i| patch.add(learned(i), seen(i)));
        correlation(&[patch]).unwrap()
    }

    #[test]
    fn colours_vary_as_learned_or_otherwise_where_lightness_hardly_does() {
        let striped: fn(usize) -> [f32; 3] =
            |i| [60.0 + (i % 2) as f32, 20.0 * (i / 2 % 2) as f32, 0.0];
        let in_dim_light: fn(usize) -> [f32; 3] =
            |i| [30.0 + 0.5 * (i % 2) as f32, 5.0 + 10.0 * (i / 2 % 2) as f32, 3.0];
        let of_other_hue: fn(usize) -> [f32; 3] =
            |i| [60.0 + (i % 2) as f32, 0.0, 20.0 * (i / 3 % 2) as f32];
        assert!(likeness(striped, in_dim_light) > 0.9);
        assert!(likeness(striped, of_other_hue) < 0.1);
    }

    #[test]
    fn a_plain_patch_hardly_counts_beside_a_painted_one() {
        let mut patches = [Looks::default(); 2];
        for i in 0..40_usize {
            let painted = [20.0 * (i % 2) as f32, 0.0, 0.0];
            let noise = |period: usize| [(i / period % 2) as f32, 0.0, 0.0];
            patches[0].add(painted, painted);
            patches[1].add(noise(1), noise(2));
        }
        assert!(correlation(&patches).unwrap() > 0.9);
    }

    #[test]
    fn two_sides_of_an_edge_are_two_patches() {
        let surfel = |normal| CloudPoint {
            part: 0,
            point: Point3::new(0.01, 0.01, 1.01),
            normal,
            lab: [50.0, 0.0, 0.0],
        };
        let slanted = Vector3::new(0.3, 0.0, -1.0).normalize();
        let cloud = Cloud::of([-Vector3::z(), Vector3::x(), slanted].map(surfel).into());
        assert_eq!(cloud.patches, [0, 1, 0]);
    }

    /// Surfels of a board 40 cm wide that are seen through where one stands this far to its right.
    fn seen_through_beside(shift: f64) -> usize {
        let side = || (-20..=20).map(|i| 0.01 * f64::from(i));
        let surfel = |(x, y)| CloudPoint {
            part: 0,
            point: Point3::new(x, y, 1.5),
            normal: -Vector3::z(),
            lab: [50.0, 0.0, 0.0],
        };
        let cloud =
            Cloud::of(side().flat_map(|x| side().map(move |y| (x, y))).map(surfel).collect());
        let seen_board = board(0.203, 1.5, 2.5);
        let scene = Scene::plain(&seen(1, |x, y| seen_board(x - shift / 1.5, y))).unwrap();
        let alone = Articulated { parts: 1, joints: Vec::new() };
        let state = State { camera_from_object: Pose::identity(), q: Vec::new() };
        verify(&scene, &alone, &cloud, &state).through
    }

    #[test]
    fn an_edge_a_little_beside_its_place_is_not_seen_through() {
        assert_eq!(seen_through_beside(0.006), 0);
        assert!(seen_through_beside(0.02) >= 41);
    }

    #[test]
    fn furniture_that_is_gone_counts_little_where_both_sides_are_seen() {
        let gone = |door| verdict(vec![part(300, 100), door]).free_space();
        assert!(gone(part(600, 0)) > 0.85);
        assert!(gone(part(0, 0)) < 0.1);
    }

    #[test]
    fn furniture_that_is_gone_counts_little_where_two_moving_parts_are_seen() {
        let base = PartVerdict { correlation: Some(0.3), ..part(300, 300) };
        let with = |others| verdict([vec![base], vec![part(500, 0); others]].concat());
        assert_eq!(with(1).free_space(), 0.0);
        assert!(with(2).free_space() > 0.7);
    }

    #[test]
    fn a_moving_part_of_other_paint_is_another() {
        let with_door = |door| Verdict { correlation: 0.8, ..verdict(vec![part(500, 0), door]) };
        let painted = |agree, correlation, texture| {
            with_door(PartVerdict { correlation, texture, ..part(agree, 0) }).looks()
        };
        assert_eq!(painted(600, Some(0.4), 0.9), 0.8);
        assert!(painted(600, Some(0.0), 0.9) < 0.1);
        // A plain one says nothing, nor does what is hardly seen.
        assert_eq!(painted(600, Some(0.0), 0.0), 0.8);
        assert_eq!(painted(80, Some(0.0), 0.9), 0.8);
        assert_eq!(painted(600, None, 0.0), 0.8);
    }

    #[test]
    fn what_is_seen_in_place_of_a_part_may_be_another_thing() {
        let looks = |correlation| PartVerdict { correlation, texture: 0.9, ..part(400, 0) };
        assert!(looks(Some(0.05)).looks_other() && !looks(Some(0.2)).looks_other());
        assert!(!looks(None).looks_other());
        assert!(part(40, 60).is_gone() && !part(60, 40).is_gone());
        assert!(!part(0, AT_EDGES).is_gone());
    }

    #[test]
    fn what_is_hidden_is_told_apart_from_what_is_seen() {
        let behind = |hidden| Verdict { judged: 600, hidden, ..Verdict::default() }.unhidden();
        assert_eq!(behind(0), 1.0);
        assert_eq!(behind(300), 2.0 / 3.0);
        assert_eq!(behind(2000), 0.5);
    }

    #[test]
    fn where_a_part_ends_speaks_for_it() {
        let ends = Ends { as_learned: 30, goes_on: 0 };
        assert!(PartVerdict { ends, ..part(500, 0) }.fit() > part(500, 0).fit());
    }

    #[test]
    fn a_surface_alone_is_half_a_mechanism() {
        let geometry = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(geometry, [0, 1], [0.0, 1.0])];
        let articulated = Articulated { parts: 2, joints };
        let with_door = |door| verdict(vec![part(500, 0), door]).mechanism(&articulated);
        assert_eq!(with_door(part(0, 0)), 0.5);
        assert!(with_door(part(30, 0)) > 0.95);
        let ends = Ends { as_learned: 60, goes_on: 0 };
        let door = PartVerdict { ends, ..part(500, 0) };
        assert!(verdict(vec![part(0, 0), door]).mechanism(&articulated) > 0.95);
    }
}
