//! Configuration of the recognition stage.

use crate::explained_config::explained_config;

explained_config! {
    /// Values of the recognition stage. All ours.
    pub struct RecogniseConfig {
        /// Probability (0 to 1) above which an object is reported. Of 6435 wrong pairs (`bench --suite
        /// recognise`, the same with `--seed 2` and `--seed 3`) none scores more. Of models learned
        /// with other seeds one did: a closed door, longer than the learned one, in a longer frame, of
        /// which a post hides half. Set where a wrong report costs more, or less, than a missed one.
        pub min_score: f64 = 0.5,
        /// Largest ratio of the best match's distance to that of the best elsewhere. Set by the
        /// ablation.
        pub max_ratio: f64 = 0.9,
        /// Pose hypotheses that are refined and verified. Set by the ablation.
        pub hypotheses: usize = 4,
        /// Where distinct matches lead to no object of a shortlist, all are tried, for what is not
        /// hidden. Set by the ablation.
        pub try_all_matches: bool = true,
        /// What no features lead to is looked for by its shape: where its surface ends. The command
        /// `recognise` does so by itself where a camera stands still and nothing else tells the object;
        /// this value asks for it in single frames and in the live service too. Of 17 encounters with
        /// plain things, on which the search was chosen, features find one and the search another one;
        /// of about 380 wrong pairs it reports none. What is not recognised then costs 0.1 to 0.4 s for
        /// each object. Set where a store holds few and different plain things.
        pub try_shape: bool = false,
        /// Most objects compared in full at a time; of more, the likeliest by their words come first,
        /// and those whose words stand out alone. Set where time for a frame is short.
        pub shortlist: usize = 6,
        /// Shortlists gone through, one after the other, until something is recognised. Set where time
        /// for a frame is short.
        pub shortlists: usize = 3,
        /// Surfaces are compared in colour too, not in depth alone. Set by the ablation.
        pub compare_looks: bool = true,
        /// Surface that is seen through counts against a state. Set by the ablation.
        pub check_free_space: bool = true,
        /// Surface that goes on where the learned one ends counts against a state. Set by the ablation.
        pub check_ends: bool = true,
        /// States are aligned by their surface too, not by matches alone. Set by the ablation.
        pub align_surface: bool = true,
        /// Hypotheses of a part in whose place another thing is seen are not followed. Set by the
        /// ablation.
        pub dismiss_early: bool = true,
        /// Configurations that few matches tell are searched for by surface. Set by the ablation.
        pub search_configurations: bool = true,
        /// Configurations are told only where no other one explains the picture about as well. Set by
        /// the ablation.
        pub check_rivals: bool = true,
        /// Configurations that nothing shows are told where all others are ruled out. Set by the
        /// ablation.
        pub eliminate: bool = true,
    }
}
