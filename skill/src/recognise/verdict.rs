//! Comparison of a state with the image: counts by part, and the scores that follow from them.
//!
//! In: counts of surfels and correlations of colour, by part, from [`super::verify`].
//! Out: scores of 0 to 1 for appearance, free space, edges and agreement in depth, whose product is the score of the
//! state; and the fit, in surfels, by which states of one object are compared.
//! From: ours; the limits were chosen with `bench --suite recognise`.

use super::edge_test::EdgeCounts;
use super::kinematics::Articulated;
use super::patch_colour::{PatchColours, correlation, texture};
use super::render_cloud::Cloud;

/// Weight of a surfel that agrees in depth but has no texture.
const PLAIN_WORTH: f64 = 0.4;
/// Weight of a surfel that agrees in depth and whose texture correlates fully with the learned one.
const TEXTURED_WORTH: f64 = 1.6;
/// Correlation of colour that another surface reaches as often as the learned one in poor light.
const CHANCE: f64 = 0.3;
/// Smallest number of surfels that agree for a part to be where a state puts it.
const LEAST_STANDING: usize = 25;
/// Smallest number of edges that end as learned for a part to be present although much of it is seen through; the
/// share of edges that end as learned is computed with this many more in all.
const LEAST_ENDS: usize = 10;
/// Weight of a base surfel that is seen through; 1 if two parts, one of them moving, have the learned colour.
const SEEN_THROUGH: f64 = 5.0;
/// Weight of a base surfel that is seen through, when states that were found by shape are compared.
const BASE_THROUGH_WORTH: f64 = 0.1;
/// Share of a moving part's surface that is seen through at which the part has another shape: score 0.
const ANOTHER_SHAPE: f64 = 0.1;
/// Share of a moving part's surface that is seen through at which it has another shape although its contour agrees:
/// score 0. Larger, because some places of a surface are learned wrongly.
const OTHER_SHAPE: f64 = 0.2;
/// Number of surfels of a part from which its texture counts against it, and from which it counts in full.
const ENOUGH_SURFACE: (f64, f64) = (100.0, 300.0);
/// Correlation of colour of a part that is another one, and of a part that may be the learned one in poor light.
const UNLIKE: (f64, f64) = (0.0, 0.25);
/// Number of surfels of a part that may be seen through at its edges, whatever its shape.
const AT_EDGES: usize = 5;

/// Comparison of one part with the image.
#[derive(Debug, Clone, Copy, Default)]
pub struct PartVerdict {
    /// Number of surfels that agree in depth and normal.
    pub agree: usize,
    /// Number of surfels that are seen through.
    pub through: usize,
    /// Correlation of colour, -1 to 1; `None` with too little surface.
    pub correlation: Option<f64>,
    /// Amount of texture of the learned colour within patches, 0 to 1: the weight of the correlation.
    pub texture: f64,
    /// Number of surfels that agree in depth and normal and have the learned colour, up to a change of light.
    pub alike: usize,
    /// What is seen beyond the edges of the part.
    pub edges: EdgeCounts,
}

impl PartVerdict {
    /// True if the surface of the part is seen where the state puts it, and its colour varies as learned.
    pub fn is_seen(&self) -> bool {
        self.agree > 4 * self.through && self.agrees_in_all()
    }

    /// True if the surface of the part is seen where the state puts it, whatever its colour.
    pub fn stands(&self) -> bool {
        self.agree >= LEAST_STANDING && self.agree > 4 * self.through
    }

    /// Share of the part's surface that is seen through, without its edges.
    fn free_space_violation(&self) -> f64 {
        let through = self.through.saturating_sub(AT_EDGES) as f64;
        through / (self.agree as f64 + through).max(1.0)
    }

    /// Agreement of the part in depth, in surfels: each counts more where the colour varies as learned, and less
    /// than nothing where a texture differs, because any plane agrees with any other in depth. Edges that end as
    /// learned are added; edges that continue and free space are subtracted.
    pub fn fit(&self) -> f64 {
        let worth = self.correlation.map_or(PLAIN_WORTH, |correlation| {
            let likeness = (correlation.max(0.0) - CHANCE) / (1.0 - CHANCE);
            PLAIN_WORTH + self.texture * (TEXTURED_WORTH * likeness - PLAIN_WORTH)
        });
        let ends = self.edges.as_learned as f64 - self.edges.goes_on as f64;
        self.agree as f64 * worth + ends - 2.0 * self.through as f64
    }

    /// Agreement of the part by depth, colour and edges, in surfels, whatever its texture. Base surface that is seen
    /// through counts little: much of it may be furniture.
    pub fn fit_of_shape(&self, is_base: bool) -> f64 {
        let ends = self.edges.as_learned as f64 - self.edges.goes_on as f64;
        let through = if is_base { BASE_THROUGH_WORTH } else { 2.0 } * self.through as f64;
        let unlike = self.agree.saturating_sub(self.alike) as f64;
        PLAIN_WORTH * (self.alike as f64 - unlike) + ends - through
    }

    /// True if the part stands where the state puts it, or if enough of it has the learned colour and ends as
    /// learned although much is seen through.
    pub fn holds(&self) -> bool {
        self.stands()
            || self.alike >= LEAST_STANDING
                && self.edges.as_learned >= LEAST_ENDS
                && self.edges.as_learned > 4 * self.edges.goes_on
    }

    /// True if too little surface of the part is in sight for it to stand.
    pub fn hardly_shows(&self) -> bool {
        self.agree + self.through < LEAST_STANDING
    }

    /// True if enough surface of the part is where the state puts it, and its colour varies as learned.
    fn agrees_in_all(&self) -> bool {
        self.agree >= LEAST_STANDING && self.correlates()
    }

    /// True if more of the part is seen through than agrees, without its edges.
    pub fn is_missing(&self) -> bool {
        self.through.saturating_sub(AT_EDGES) > self.agree
    }

    /// True if the texture is more likely that of another object.
    pub fn has_other_texture(&self) -> bool {
        self.texture_mismatch() > 0.5
    }

    /// True if the part has texture and its colour varies contrary to the learned one, however little of it is seen: a
    /// dresser's front was taken for a freezer's lid by 72 surfels with a correlation of -0.63.
    pub fn is_unlike(&self) -> bool {
        self.texture > 0.5 && self.correlation.is_some_and(|c| c < UNLIKE.0)
    }

    /// How certainly, 0 to 1, the part is in its place and has a texture that is not the learned one.
    fn texture_mismatch(&self) -> f64 {
        let ramp = |x: f64, (from, to): (f64, f64)| ((x - from) / (to - from)).clamp(0.0, 1.0);
        let unlike = self.correlation.map_or(0.0, |c| 1.0 - ramp(c, UNLIKE));
        ramp(self.agree as f64, ENOUGH_SURFACE) * self.texture * unlike
    }

    /// How well the part looks as learned, 0 to 1: correlation of colour as far as it has texture, and the share of its
    /// surface that has the learned colour.
    fn appearance(&self) -> f64 {
        let alike = self.alike as f64 / self.agree.max(1) as f64;
        let texture = if self.correlation.is_some() { self.texture } else { 0.0 };
        texture * self.correlation.unwrap_or(0.0).max(0.0) + (1.0 - texture) * alike
    }

    /// True if the colour of the part varies as learned.
    pub fn correlates(&self) -> bool {
        self.correlation.is_some_and(|c| c > 0.4)
    }
}

/// Comparison of a state with the image.
#[derive(Debug, Clone, Default)]
pub struct Verdict {
    /// Number of visible surfels at pixels with depth, less the occluded ones (of which at most half of all are
    /// subtracted).
    pub judged: usize,
    /// Number of surfels at the right depth.
    pub agree: usize,
    /// Number of surfels at the right depth with the right normal.
    pub agree_normal: usize,
    /// Number of surfels in free space: they are seen through.
    pub through: usize,
    /// Number of surfels behind an occluder.
    pub hidden: usize,
    /// Correlation of colour of all parts, -1 to 1.
    pub correlation: f64,
    /// Comparison of each part.
    pub parts: Vec<PartVerdict>,
}

impl Verdict {
    /// Verdict before any comparison.
    pub fn nothing_yet(parts: usize) -> Self {
        Self { parts: vec![PartVerdict::default(); parts], ..Self::default() }
    }

    /// Score of the appearance, 0 to 1: correlation of colour, lowered by [`Self::own_texture`], because a door of
    /// another paint is another door, however well the rest correlates.
    pub fn appearance_score(&self) -> f64 {
        self.correlation.max(0.0) * self.own_texture()
    }

    /// 1, or less if a moving part is where the state puts it but has another texture than the learned one; 0 if it
    /// is certainly another object.
    pub fn own_texture(&self) -> f64 {
        1.0 - self.parts.iter().skip(1).map(PartVerdict::texture_mismatch).fold(0.0, f64::max)
    }

    /// Score, 0 to 1, of a state of an object that was recognised before and is followed. Colour correlates only as far
    /// as the learned surface has texture; the rest of it must have the learned colour. Of a plain box all surface was
    /// in its place while its colour correlated by 0.2.
    pub fn score_of_followed(&self) -> f64 {
        let of_part = |part: &PartVerdict| part.agree as f64 * part.appearance();
        let agree: usize = self.parts.iter().map(|part| part.agree).sum();
        let appearance = self.parts.iter().map(of_part).sum::<f64>() / agree.max(1) as f64;
        let mismatch = self.parts.iter().map(PartVerdict::texture_mismatch).fold(0.0, f64::max);
        let fit = self.free_space() * self.edge_score() * self.agreement(usize::MAX);
        appearance * (1.0 - mismatch) * fit
    }

    /// Score of free space, 0 to 1: less than 1 if the state claims surface that is seen through. Missing surface of
    /// the base may be furniture, and counts as a share of all; each moving part is judged by itself.
    pub fn free_space(&self) -> f64 {
        let of_base = self.parts.first().map_or(0, |p| p.through);
        let worth = if self.is_known() { 1.0 } else { SEEN_THROUGH };
        let base = worth * of_base as f64 / self.judged.max(1) as f64;
        let worst =
            self.parts.iter().skip(1).map(PartVerdict::free_space_violation).fold(0.0, f64::max);
        (1.0 - base - worst / ANOTHER_SHAPE).max(0.0)
    }

    /// Score of the edges, 0 to 1, of the worst part: less than 1 if its surface continues beyond the learned edges.
    pub fn edge_score(&self) -> f64 {
        let all = self.parts.iter().enumerate().map(|(i, part)| part.edges.likeness(i == 0));
        all.fold(1.0, f64::min)
    }

    /// Share of the surface that is where the state puts it, 0 to 1, lowered if there is little surface or there are
    /// few matches.
    pub fn agreement(&self, inliers: usize) -> f64 {
        let gone = if self.is_known() { self.parts[0].through } else { 0 };
        self.agree as f64 / self.judged.saturating_sub(gone).max(1) as f64
            * (1.0 - (-(self.agree_normal as f64) / 200.0).exp())
            * (1.0 - (-(inliers as f64) / 3.0).exp())
    }

    /// Share of the surface in its place that has the learned colour, 0 to 1, lowered by [`Self::own_texture`].
    pub fn likeness(&self) -> f64 {
        let alike: usize = self.parts.iter().map(|part| part.alike).sum();
        self.own_texture() * alike as f64 / self.agree_normal.max(1) as f64
    }

    /// Score of free space, 0 to 1, of a state found by shape. `base_known`: the base stands where the state puts
    /// it, so that its surface that is seen through was furniture and does not count.
    pub fn free_space_of_shape(&self, base_known: bool) -> f64 {
        let Some((base, moving)) = self.parts.split_first() else { return 1.0 };
        let worth = if base_known { 0.0 } else { 1.0 };
        let worst = moving.iter().map(PartVerdict::free_space_violation).fold(0.0, f64::max);
        let of_base = worth * base.through as f64 / self.judged.max(1) as f64;
        (1.0 - of_base - worst / OTHER_SHAPE).max(0.0)
    }

    /// Share of the edges in sight that end as learned, 0 to 1: of all parts, or of the worst moving part if that is
    /// less.
    pub fn end_share(&self) -> f64 {
        let share = |as_learned: usize, goes_on: usize| {
            1.0 - goes_on as f64 / (as_learned + goes_on + LEAST_ENDS) as f64
        };
        let ends = |parts: &[PartVerdict]| {
            let as_learned = parts.iter().map(|p| p.edges.as_learned).sum();
            share(as_learned, parts.iter().map(|p| p.edges.goes_on).sum())
        };
        let moving =
            self.parts.iter().skip(1).filter(|p| p.edges.as_learned + p.edges.goes_on > 10);
        moving.map(|p| ends(std::slice::from_ref(p))).fold(ends(&self.parts), f64::min)
    }

    /// Share of the surface in sight that is where the state puts it, 0 to 1, lowered if there is little of it.
    /// `base_known`: base surface that is seen through does not count.
    pub fn coverage(&self, base_known: bool) -> f64 {
        let gone = if base_known { self.parts[0].through } else { 0 };
        let share = self.agree as f64 / self.judged.saturating_sub(gone).max(1) as f64;
        share * (1.0 - (-(self.agree_normal as f64) / 200.0).exp())
    }

    /// Share of the surface that is not occluded, 0.5 to 1.
    pub fn visible_ratio(&self) -> f64 {
        let forgiven = self.hidden.min(self.judged);
        self.judged as f64 / (self.judged + forgiven).max(1) as f64
    }

    /// Sets the correlation of all parts together, and correlation and texture of each part, from the colours of
    /// each patch.
    pub fn set_correlations(&mut self, cloud: &Cloud, colours: &[PatchColours]) {
        self.correlation = correlation(colours).unwrap_or(0.0);
        let of_parts = || cloud.part_of_patch.iter().zip(colours);
        for (number, part) in self.parts.iter_mut().enumerate() {
            let own: Vec<PatchColours> =
                of_parts().filter(|p| *p.0 == number).map(|p| *p.1).collect();
            part.correlation = correlation(&own);
            part.texture = texture(&own);
        }
    }

    /// Factor of 0.5 to 1: small if at every joint one side shows almost nothing, unless moving parts end as
    /// learned. A surface alone may be that of another object.
    pub fn articulation_evidence(&self, articulated: &Articulated) -> f64 {
        let both_sides = (0..articulated.joints.len()).map(|joint| {
            let moved = articulated.moved_by(joint);
            let on = |side: bool| -> usize {
                let own = |(part, _): &(usize, &PartVerdict)| moved.contains(part) == side;
                self.parts.iter().enumerate().filter(own).map(|(_, p)| p.agree).sum()
            };
            on(true).min(on(false))
        });
        let ends: usize = self.parts.iter().skip(1).map(|part| part.edges.as_learned).sum();
        let evidence = both_sides.max().unwrap_or(0) as f64 / 10.0 + ends as f64 / 20.0;
        1.0 - 0.5 * (-evidence).exp()
    }

    /// True if two parts, at least one of them moving, have the learned colour where the joints put them. Surface of
    /// the base that is missing may then be furniture that stood beside the object.
    fn is_known(&self) -> bool {
        self.parts.split_first().is_some_and(|(base, rest)| {
            let moving = rest.iter().filter(|part| part.is_seen()).count();
            moving + usize::from(base.agrees_in_all()) >= 2 && moving > 0
        })
    }

    /// Sum of [`PartVerdict::fit_of_shape`] over all parts, for comparing states that were found by shape.
    pub fn fit_of_shape(&self) -> f64 {
        self.parts.iter().enumerate().map(|(i, part)| part.fit_of_shape(i == 0)).sum()
    }

    /// Sum of [`PartVerdict::fit`] over all parts, for comparing configurations.
    pub fn fit(&self) -> f64 {
        self.parts.iter().map(PartVerdict::fit).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object::joint_geometry::JointGeometry;
    use crate::recognise::kinematics::ChainJoint;
    use nalgebra::{Point3, Vector3};

    fn part(agree: usize, through: usize) -> PartVerdict {
        PartVerdict { agree, through, correlation: Some(0.9), ..PartVerdict::default() }
    }

    fn verdict(parts: Vec<PartVerdict>) -> Verdict {
        let agree = parts.iter().map(|p| p.agree).sum();
        let through: usize = parts.iter().map(|p| p.through).sum();
        Verdict { judged: agree + through, agree, agree_normal: agree, parts, ..Verdict::default() }
    }

    #[test]
    fn what_is_followed_need_not_correlate_where_it_has_no_texture() {
        let score = |texture, correlation, alike| {
            let part = PartVerdict { texture, correlation, alike, ..part(900, 0) };
            verdict(vec![part]).score_of_followed()
        };
        assert!(score(0.0, None, 900) > 0.9 && score(0.3, Some(0.2), 880) > 0.6);
        assert!(score(0.0, None, 90) < 0.15, "it has another colour");
        assert!(score(0.9, Some(0.9), 900) > 0.8 && score(0.9, Some(0.0), 900) < 0.05);
    }

    #[test]
    fn a_moving_part_that_is_seen_through_has_another_shape() {
        let with_door = |through| verdict(vec![part(2000, 0), part(300, through)]).free_space();
        assert_eq!(with_door(AT_EDGES), 1.0);
        assert!(with_door(12) > 0.7);
        assert!(with_door(30) < 0.3);
        assert_eq!(with_door(60), 0.0);
    }

    #[test]
    fn furniture_that_is_missing_counts_little_where_both_sides_are_seen() {
        let gone = |door| verdict(vec![part(300, 100), door]).free_space();
        assert!(gone(part(600, 0)) > 0.85);
        assert!(gone(part(0, 0)) < 0.1);
    }

    #[test]
    fn furniture_that_is_missing_counts_little_where_two_moving_parts_are_seen() {
        let base = PartVerdict { correlation: Some(0.3), ..part(300, 300) };
        let with = |others| verdict([vec![base], vec![part(500, 0); others]].concat());
        assert_eq!(with(1).free_space(), 0.0);
        assert!(with(2).free_space() > 0.7);
    }

    #[test]
    fn a_moving_part_of_other_paint_is_another() {
        let with_door = |door| Verdict { correlation: 0.8, ..verdict(vec![part(500, 0), door]) };
        let painted = |agree, correlation, texture| {
            with_door(PartVerdict { correlation, texture, ..part(agree, 0) }).appearance_score()
        };
        assert_eq!(painted(600, Some(0.4), 0.9), 0.8);
        assert!(painted(600, Some(0.0), 0.9) < 0.1);
        // Plain parts, and parts that are hardly seen, give no evidence.
        assert_eq!(painted(600, Some(0.0), 0.0), 0.8);
        assert_eq!(painted(80, Some(0.0), 0.9), 0.8);
        assert_eq!(painted(600, None, 0.0), 0.8);
    }

    #[test]
    fn what_is_seen_in_place_of_a_part_may_be_another_thing() {
        let looks = |correlation| PartVerdict { correlation, texture: 0.9, ..part(400, 0) };
        assert!(looks(Some(0.05)).has_other_texture() && !looks(Some(0.2)).has_other_texture());
        assert!(!looks(None).has_other_texture());
        assert!(looks(Some(-0.1)).is_unlike() && !looks(Some(0.1)).is_unlike());
        assert!(!looks(None).is_unlike());
        assert!(part(40, 60).is_missing() && !part(60, 40).is_missing());
        assert!(!part(0, AT_EDGES).is_missing());
    }

    #[test]
    fn what_is_hidden_is_told_apart_from_what_is_seen() {
        let behind = |hidden| Verdict { judged: 600, hidden, ..Verdict::default() }.visible_ratio();
        assert_eq!(behind(0), 1.0);
        assert_eq!(behind(300), 2.0 / 3.0);
        assert_eq!(behind(2000), 0.5);
    }

    #[test]
    fn where_a_part_ends_speaks_for_it() {
        let edges = EdgeCounts { as_learned: 30, goes_on: 0 };
        assert!(PartVerdict { edges, ..part(500, 0) }.fit() > part(500, 0).fit());
    }

    #[test]
    fn a_surface_alone_is_half_a_articulation_evidence() {
        let geometry = JointGeometry::hinge(Vector3::y_axis(), Point3::origin());
        let joints = vec![ChainJoint::new(geometry, [0, 1], [0.0, 1.0])];
        let articulated = Articulated { parts: 2, joints };
        let with_door =
            |door| verdict(vec![part(500, 0), door]).articulation_evidence(&articulated);
        assert_eq!(with_door(part(0, 0)), 0.5);
        assert!(with_door(part(30, 0)) > 0.95);
        let edges = EdgeCounts { as_learned: 60, goes_on: 0 };
        let door = PartVerdict { edges, ..part(500, 0) };
        assert!(verdict(vec![part(0, 0), door]).articulation_evidence(&articulated) > 0.95);
    }
}
