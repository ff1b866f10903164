//! Channels on the LCM network.

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
