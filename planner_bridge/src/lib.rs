//! From predictions to plans: jerk-limited trajectories, and the messages that planners and
//! viewers subscribe to.

pub mod client;
pub mod joint_deviation;
pub mod limits;
pub mod messages;
pub mod plan;
pub mod service;
pub mod trajectory;

pub use client::{Client, ClientError};
pub use limits::{Access, MotionLimits, Rig, RigError, Safety, Streaming, Synchronisation};
pub use plan::{PREDICTION_SCHEMA, Plan, PlanError, Prediction, Request, predict};
pub use trajectory::{Knot, Task, TrajectoryError, knots, time_optimal, together};

/// Channels of DESIGN 4.7.
pub mod channel {
    /// `linkage.model_t`.
    pub const MODEL: &str = "LINKAGE_MODEL";
    /// `linkage.recognition_t`.
    pub const RECOGNITION: &str = "LINKAGE_RECOGNITION";
    /// `linkage.prediction_t`.
    pub const PREDICTION: &str = "LINKAGE_PREDICTION";
    /// `articulation.articulated_object_msg_t`.
    pub const ARTICULATED_OBJECT: &str = "ARTICULATED_OBJECT";
    /// Drake's `lcmt_robot_plan`.
    pub const PLAN: &str = "LINKAGE_PLAN";
    /// `linkage.setpoint_t`.
    pub const SETPOINT: &str = "LINKAGE_SETPOINT";
    /// `linkage.heartbeat_t`.
    pub const HEARTBEAT: &str = "LINKAGE_HEARTBEAT";
    /// `linkage.status_t`.
    pub const STATUS: &str = "LINKAGE_STATUS";
    /// `linkage.command_t`.
    pub const COMMAND: &str = "LINKAGE_COMMAND";
}
