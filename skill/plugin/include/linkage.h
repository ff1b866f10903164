/* Linkage: learns how doors, drawers and other articulated things move by watching a person move
 * them once, recognises them, and predicts their motion.
 *
 * SI units and radians; utime in microseconds. Poses are x y z qx qy qz qw; `camera_from_part` maps
 * the part's coordinates into the camera frame (x right, y down, z forward). Part axes are the
 * object frame's at configuration 0.
 *
 * Functions return LINKAGE_OK or why they failed; linkage_last_error() says it in words. Nothing
 * throws, aborts or prints. A linkage_session may be used from several threads: its calls wait for
 * each other. A recognition or prediction does not change, and may be read by several threads at
 * once; who frees it sees to it that nobody reads it any more.
 *
 * Text that is handed out belongs to the object that it came from and lives as long.
 *
 * Made by cbindgen from skill/plugin/src; do not edit. */

#ifndef LINKAGE_H
#define LINKAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/*
 How a call ended; the same numbers as the exit status of the linkage program.
 */
typedef enum {
  /*
   Done.
   */
  LINKAGE_RESULT_OK = 0,
  /*
   The input did not allow an answer: nothing moved, nothing was recognised.
   */
  LINKAGE_RESULT_NO_ANSWER = 1,
  /*
   What was given cannot be used.
   */
  LINKAGE_RESULT_BAD_INPUT = 2,
  /*
   A fault of the library, or of one that it uses.
   */
  LINKAGE_RESULT_INTERNAL = 3,
} linkage_result;

/*
 How depth is given; registered to colour either way.
 */
typedef enum {
  /*
   uint16_t, millimetres, 0 where there is no reading.
   */
  LINKAGE_DEPTH_FORMAT_MILLIMETRES_U16 = 0,
  /*
   float, metres, 0 or NaN where there is no reading.
   */
  LINKAGE_DEPTH_FORMAT_METRES_F32 = 1,
} linkage_depth_format;

/*
 Which paths are meant.
 */
typedef enum {
  /*
   Of the parts' own frames.
   */
  LINKAGE_PATH_KIND_PART = 0,
  /*
   Of what a gripper holds.
   */
  LINKAGE_PATH_KIND_HANDLE = 1,
} linkage_path_kind;

/*
 A planned motion: a trajectory for each joint that moves, a path for each part that it moves,
 and one for what a gripper holds on such a part.
 */
typedef struct linkage_prediction linkage_prediction;

/*
 What was recognised in a frame, best first.
 */
typedef struct linkage_recognition linkage_recognition;

/*
 The skill: what is known, and what is being demonstrated.
 */
typedef struct linkage_session linkage_session;

/*
 A pinhole camera, in pixels; the centre of the top-left pixel is (0, 0).
 */
typedef struct {
  /*
   Columns.
   */
  uint32_t width;
  /*
   Rows.
   */
  uint32_t height;
  /*
   Focal length along x.
   */
  double fx;
  /*
   Focal length along y.
   */
  double fy;
  /*
   Principal point, column.
   */
  double cx;
  /*
   Principal point, row.
   */
  double cy;
  /*
   Brown's k1 k2 p1 p2 k3, as OpenCV has it; zeros for none.
   */
  double distortion[5];
} linkage_camera;

/*
 A frame. Its buffers are read during the call alone.
 */
typedef struct {
  /*
   When it was taken, microseconds; later than the frame before it.
   */
  int64_t utime;
  /*
   Of colour and depth.
   */
  linkage_camera camera;
  /*
   Red, green, blue, 8 bits each, the top row first.
   */
  const uint8_t *rgb;
  /*
   Bytes from row to row.
   */
  uintptr_t rgb_stride;
  /*
   Depth along the optical axis, the top row first.
   */
  const void *depth;
  /*
   Bytes from row to row.
   */
  uintptr_t depth_stride;
  /*
   One of linkage_depth_format.
   */
  uint32_t depth_format;
} linkage_frame;

/*
 What is to be predicted.
 */
typedef struct {
  /*
   The joint to move; NULL or empty for all that were seen.
   */
  const char *joint;
  /*
   open, closed, or a configuration in radians or metres.
   */
  const char *target;
  /*
   A target outside the range that was seen is allowed, by at most a turn or a metre.
   */
  bool outside_range;
  /*
   `grasp` is given; else handles are where the demonstrator's hand was.
   */
  bool has_grasp;
  /*
   What the gripper holds now: a point in the camera frame, metres.
   */
  double grasp[3];
} linkage_request;

/*
 A recognised object.
 */
typedef struct {
  /*
   Its name.
   */
  const char *object;
  /*
   0 to 1.
   */
  double score;
  /*
   Pose of the object frame.
   */
  double camera_from_object[7];
  /*
   False where nothing tells where the base is: `camera_from_object` is then a guess, while
   the joints are right.
   */
  bool base_known;
  /*
   Number of its joints.
   */
  uintptr_t joint_count;
} linkage_match;

/*
 A joint of a recognised object, in the camera frame.
 */
typedef struct {
  /*
   Its name.
   */
  const char *name;
  /*
   prismatic, revolute, helical or nonparametric.
   */
  const char *kind;
  /*
   Unit direction.
   */
  double axis[3];
  /*
   A point on it, metres.
   */
  double origin[3];
  /*
   Metres a turn, of helical joints; else 0.
   */
  double pitch;
  /*
   Least and greatest configuration that was demonstrated.
   */
  double range[2];
  /*
   False where nothing that was seen tells the configuration.
   */
  bool configuration_known;
  /*
   Radians or metres; NaN where it is not known.
   */
  double configuration;
  /*
   Why it is not known; empty where it is.
   */
  const char *reason;
} linkage_joint;

/*
 The motion of one joint.
 */
typedef struct {
  /*
   The joint's name.
   */
  const char *joint;
  /*
   Number of its points, at least two.
   */
  uintptr_t point_count;
} linkage_trajectory;

/*
 A joint at an instant.
 */
typedef struct {
  /*
   Seconds from the start.
   */
  double time;
  /*
   Configuration; radians or metres.
   */
  double position;
  /*
   Velocity.
   */
  double velocity;
  /*
   Acceleration.
   */
  double acceleration;
} linkage_point;

/*
 The way of a part, or of what a gripper holds on it.
 */
typedef struct {
  /*
   The part's name.
   */
  const char *part;
  /*
   Number of its poses, at least two.
   */
  uintptr_t pose_count;
} linkage_path;

/*
 Where something is at an instant.
 */
typedef struct {
  /*
   Seconds from the start.
   */
  double time;
  /*
   x y z qx qy qz qw, into the camera frame.
   */
  double camera_from_it[7];
} linkage_pose;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 Why the calling thread's last failed call failed; empty when none did. Valid until its next
 call that fails.
 */
const char *linkage_last_error(void);

/*
 The library's version.
 */
const char *linkage_version(void);

/*
 Opens a store, or makes an empty one. `profile` is NULL for the default; `rig` is a file with
 motion limits, or NULL for the default ones.

 # Safety
 The texts are NULL or NUL-terminated; `out` is valid for a write.
 */
linkage_result linkage_open(const char *store,
                            const char *profile,
                            const char *rig,
                            linkage_session **out);

/*
 Closes a skill; a demonstration that runs is dropped. NULL is left alone.

 # Safety
 `session` is NULL, or came from linkage_open and is not used any more.
 */
void linkage_close(linkage_session *session);

/*
 Number of objects that are known; 0 for NULL.

 # Safety
 `session` is NULL, or came from linkage_open.
 */
uintptr_t linkage_object_count(const linkage_session *session);

/*
 An object's model as JSON (linkage.model/1); free it with linkage_free_text.

 # Safety
 `session` came from linkage_open; `object` is NUL-terminated; `out` is valid for a write.
 */
linkage_result linkage_model_json(const linkage_session *session, const char *object, char **out);

/*
 Frees what linkage_model_json gave. NULL is left alone.

 # Safety
 `text` is NULL, or came from linkage_model_json and is not used any more.
 */
void linkage_free_text(char *text);

/*
 Begins to watch how a person moves an object. One that is known already gets another
 demonstration.

 # Safety
 `session` came from linkage_open; `object` is NUL-terminated.
 */
linkage_result linkage_start_demonstration(linkage_session *session, const char *object);

/*
 Gives the next frame of the demonstration.

 # Safety
 `session` came from linkage_open; the frame's buffers hold what it says.
 */
linkage_result linkage_feed(linkage_session *session, const linkage_frame *frame);

/*
 Learns from the demonstration and stores the object. LINKAGE_RESULT_NO_ANSWER when nothing
 articulated was moved. The demonstration is over either way.

 # Safety
 `session` came from linkage_open.
 */
linkage_result linkage_finish_demonstration(linkage_session *session);

/*
 Drops the demonstration that runs, if any.

 # Safety
 `session` came from linkage_open.
 */
linkage_result linkage_cancel_demonstration(linkage_session *session);

/*
 Looks for all that is known in one frame. An answer without matches is LINKAGE_RESULT_OK.

 # Safety
 `session` came from linkage_open; the frame's buffers hold what it says; `out` is valid for a
 write.
 */
linkage_result linkage_recognise(linkage_session *session,
                                 const linkage_frame *frame,
                                 linkage_recognition **out);

/*
 Plans the motion of a recognised object. LINKAGE_RESULT_NO_ANSWER when the joint's present
 configuration was not seen.

 # Safety
 `session` came from linkage_open, `recognition` from linkage_recognise; the request's texts are
 NULL or NUL-terminated; `out` is valid for a write.
 */
linkage_result linkage_predict(const linkage_session *session,
                               const linkage_recognition *recognition,
                               uintptr_t match_index,
                               const linkage_request *request,
                               linkage_prediction **out);

/*
 Number of recognised objects; 0 for NULL.

 # Safety
 `recognition` is NULL, or came from linkage_recognise.
 */
uintptr_t linkage_match_count(const linkage_recognition *recognition);

/*
 A recognised object, the best at index 0.

 # Safety
 `recognition` came from linkage_recognise; `out` is valid for a write.
 */
linkage_result linkage_match_at(const linkage_recognition *recognition,
                                uintptr_t index,
                                linkage_match *out);

/*
 A joint of a recognised object.

 # Safety
 `recognition` came from linkage_recognise; `out` is valid for a write.
 */
linkage_result linkage_joint_at(const linkage_recognition *recognition,
                                uintptr_t match_index,
                                uintptr_t joint_index,
                                linkage_joint *out);

/*
 Frees a recognition. NULL is left alone.

 # Safety
 `recognition` is NULL, or came from linkage_recognise and is not used any more.
 */
void linkage_free_recognition(linkage_recognition *recognition);

/*
 Number of joints that move; 0 for NULL.

 # Safety
 `prediction` is NULL, or came from linkage_predict.
 */
uintptr_t linkage_trajectory_count(const linkage_prediction *prediction);

/*
 The trajectory of a joint that moves.

 # Safety
 `prediction` came from linkage_predict; `out` is valid for a write.
 */
linkage_result linkage_trajectory_at(const linkage_prediction *prediction,
                                     uintptr_t index,
                                     linkage_trajectory *out);

/*
 A point of a trajectory.

 # Safety
 `prediction` came from linkage_predict; `out` is valid for a write.
 */
linkage_result linkage_point_at(const linkage_prediction *prediction,
                                uintptr_t trajectory_index,
                                uintptr_t point_index,
                                linkage_point *out);

/*
 Number of paths of a kind (linkage_path_kind); 0 for NULL.

 # Safety
 `prediction` is NULL, or came from linkage_predict.
 */
uintptr_t linkage_path_count(const linkage_prediction *prediction, uint32_t kind);

/*
 A path of a kind (linkage_path_kind).

 # Safety
 `prediction` came from linkage_predict; `out` is valid for a write.
 */
linkage_result linkage_path_at(const linkage_prediction *prediction,
                               uint32_t kind,
                               uintptr_t index,
                               linkage_path *out);

/*
 A pose of a path.

 # Safety
 `prediction` came from linkage_predict; `out` is valid for a write.
 */
linkage_result linkage_pose_at(const linkage_prediction *prediction,
                               uint32_t kind,
                               uintptr_t path_index,
                               uintptr_t pose_index,
                               linkage_pose *out);

/*
 Frees a prediction. NULL is left alone.

 # Safety
 `prediction` is NULL, or came from linkage_predict and is not used any more.
 */
void linkage_free_prediction(linkage_prediction *prediction);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* LINKAGE_H */
