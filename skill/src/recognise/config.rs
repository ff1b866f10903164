//! Configuration of the recognition stage.

use crate::explained_config::explained_config;

explained_config! {
    /// Values of the recognition stage. All ours.
    pub struct RecogniseConfig {
        /// Probability (0 to 1) above which an object is reported. Of 6435 pairs in which the object
        /// is absent (`bench --suite recognise`, the same with `--seed 2` and `--seed 3`) none scores more. Of models learned
        /// with other seeds one did: a closed door, longer than the learned one, in a longer frame, of
        /// which a post hides half. Set where a false positive costs more, or less, than a missed object.
        pub min_score: f64 = 0.5,
        /// Largest ratio of the best match's distance to that of the best elsewhere. Set by the
        /// ablation.
        pub max_ratio: f64 = 0.9,
        /// Pose hypotheses that are refined and verified. Set by the ablation.
        pub hypotheses: usize = 4,
        /// All matches are tried where the distinct ones lead to no object of a shortlist. Set by the
        /// ablation.
        pub try_all_matches: bool = true,
        /// Objects to which no features lead are searched for by their shape: where their surface ends.
        /// The command `recognise` and the live service do so where the camera stands still and features
        /// find nothing; this value switches it on in single frames too. Of 17 encounters with
        /// plain things, on which the search was chosen, features find one and the search another one;
        /// of about 380 pairs in which the object is absent it reports none. An object that is not
        /// recognised then costs 0.1 to 0.4 s. Set where a store holds few and different plain things.
        pub try_shape: bool = false,
        /// Most objects that are compared in full at a time. Of more, the likeliest by their visual words
        /// come first. Set where time for a frame is short.
        pub shortlist: usize = 6,
        /// Shortlists gone through, one after the other, until something is recognised. Set where time
        /// for a frame is short.
        pub shortlists: usize = 3,
        /// Surfaces are compared in colour too, and not only in depth. Set by the ablation.
        pub compare_colour: bool = true,
        /// Surface that is seen through counts against a state. Set by the ablation.
        pub check_free_space: bool = true,
        /// A surface that continues where the learned one has an occlusion edge counts against a state.
        /// Set by the ablation.
        pub check_edges: bool = true,
        /// States are aligned by their surface too, not by matches alone. Set by the ablation.
        pub align_surface: bool = true,
        /// A hypothesis is rejected early where another thing is seen in the place of its part. Set by
        /// the ablation.
        pub dismiss_early: bool = true,
        /// Configurations that few matches determine are searched for by surface. Set by the ablation.
        pub search_configurations: bool = true,
        /// A configuration is reported only if no other one explains the image about as well. Set by
        /// the ablation.
        pub check_ambiguity: bool = true,
        /// A configuration without direct evidence is reported if all others are excluded. Set by the
        /// ablation.
        pub eliminate: bool = true,
    }
}
