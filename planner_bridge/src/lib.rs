//! From predictions to plans: jerk-limited trajectories, and the messages that planners and
//! viewers subscribe to.

pub mod channel;
pub mod client;
pub mod joint_deviation;
pub mod limits;
pub mod mechanics;
pub mod messages;
pub mod plan;
pub mod service;
pub mod trajectory;

pub use client::{Client, ClientError};
pub use limits::{Access, MotionLimits, Rig, RigError, Safety, Streaming, Synchronisation};
pub use mechanics::{JointMechanics, Mechanics, ObjectMechanics};
pub use plan::{PREDICTION_SCHEMA, Plan, PlanError, Prediction, Request, predict};
pub use trajectory::{Knot, Task, TrajectoryError, knots, time_optimal, together};
