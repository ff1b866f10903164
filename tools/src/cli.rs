//! Options of the command line.

use crate::console::LogFormat;
use crate::simulate::Surfaces;
use clap::{Args, Parser, Subcommand, ValueEnum};
use linkage_skill::articulation::Columns;
use std::path::PathBuf;

/// Learns how articulated things move by watching a person move them once; recognises them,
/// predicts their motion, and publishes it over LCM.
#[derive(Debug, Parser)]
#[command(name = "linkage", version, max_term_width = 100)]
pub struct Cli {
    #[command(flatten)]
    pub common: Common,
    #[command(subcommand)]
    pub command: Command,
}

/// Options of all commands.
#[derive(Debug, Clone, Args)]
pub struct Common {
    /// Configuration file: holds what differs from the profile
    #[arg(long, global = true, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Profile: default, paper or katz
    #[arg(long, global = true, default_value = "default", value_name = "NAME")]
    pub profile: String,
    /// Seed of all random sampling
    #[arg(long, global = true, value_name = "N")]
    pub seed: Option<u64>,
    /// Neither progress nor a summary: errors and warnings alone, and what --json and other options ask for
    #[arg(long, global = true)]
    pub quiet: bool,
    /// How log events are written to standard error; RUST_LOG says which
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text, value_name = "FORMAT")]
    pub log_format: LogFormat,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    /// The whole pipeline once on simulated recordings: learn, recognise, predict, publish
    Demo(DemoArgs),
    /// Learn an object from demonstrations
    Learn(LearnArgs),
    /// Recognise learned objects and how they stand
    Recognise(RecogniseArgs),
    /// Predict a recognised object's motion to a target, and publish it
    Predict(PredictArgs),
    /// Watch a source, take commands over LCM, publish models, recognitions and plans
    Serve(ServeArgs),
    /// Tell a running service what to do
    #[command(name = "command")]
    Tell(CommandArgs),
    /// Print what a running service publishes
    Listen(ListenArgs),
    /// Record what a source delivers
    Record(RecordArgs),
    /// Send what a source delivers over LCM, as kinect.frame_msg_t
    Replay(ReplayArgs),
    /// Fit joints to pose logs
    Fit(FitArgs),
    /// List, show, remove or merge stored objects
    Store(StoreArgs),
    /// Write a stored object's model to a file
    Export(ExportArgs),
    /// Render a recording with exact truth
    Simulate(SimulateArgs),
    /// Make the vocabulary again that stores are indexed with (for those who change features)
    Vocabulary(VocabularyArgs),
    /// Score recordings with truth beside them
    Bench(BenchArgs),
    /// Check what this machine has: libraries, cameras, LCM; measure a source
    Doctor(DoctorArgs),
    /// Print the effective configuration
    Config(ConfigArgs),
}

/// Which frames of a source are taken, and by which camera they were seen.
#[derive(Debug, Clone, Default, Args)]
pub struct SourceArgs {
    /// camera.toml of a source that does not tell its camera (LCM, V4L2, a log)
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Take so many frames; a live camera is otherwise watched until Ctrl-C
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Take frames for so long
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
}

/// Store that commands use where none is named.
pub const DEFAULT_STORE: &str = "objects.linkage";

#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for recordings, JSON and pictures
    #[arg(long, default_value = "out/demo", value_name = "DIR")]
    pub out: PathBuf,
}

#[derive(Debug, Args)]
pub struct RecogniseArgs {
    /// A recording (a folder, .mcap, .bag or .db3), mcap:, bag: or rosbag2: with
    /// #COLOR_TOPIC,DEPTH_TOPIC behind it, oni:FILE, lcmlog:FILE[#CHANNEL], lcm:URL[#CHANNEL],
    /// freenect:N, openni2:URI or v4l:COLOUR,DEPTH
    pub source: String,
    #[command(flatten)]
    pub take: SourceArgs,
    /// Store with the learned objects
    #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
    pub store: PathBuf,
    /// Write linkage.recognition/1; - for standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the frame and the results to a new MCAP file, for Foxglove and rerun. (In a program that
    /// was built with --features view.)
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Write a page to look at: what is recognised, how far it is open, and why a joint is not told
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct PredictArgs {
    /// A recording (a folder, .mcap, .bag or .db3), mcap:, bag: or rosbag2: with
    /// #COLOR_TOPIC,DEPTH_TOPIC behind it, oni:FILE, lcmlog:FILE[#CHANNEL], lcm:URL[#CHANNEL],
    /// freenect:N, openni2:URI or v4l:COLOUR,DEPTH
    pub source: String,
    #[command(flatten)]
    pub take: SourceArgs,
    /// Store with the learned objects
    #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
    pub store: PathBuf,
    /// Joint to move; all that were seen where none is named
    #[arg(long, value_name = "NAME")]
    pub joint: Option<String>,
    /// open, closed, or a configuration in radians or metres
    #[arg(long, default_value = "open", value_name = "TARGET", allow_hyphen_values = true)]
    pub to: String,
    /// Publish over LCM; without a URL the rig's
    #[arg(long, value_name = "URL", num_args = 0..=1, default_missing_value = "")]
    pub publish: Option<String>,
    /// Rig file with motion limits
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Write linkage.prediction/1; - for standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write a page to look at: how each joint will move, or why no motion is predicted
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ServeArgs {
    /// Where frames come from, as for learn
    #[arg(long, value_name = "SOURCE")]
    pub source: String,
    /// camera.toml of a source that does not tell its camera (LCM, V4L2, a log)
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// Store with the learned objects; made with the first of them
    #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
    pub store: PathBuf,
    /// LCM network; the rig's where none is given
    #[arg(long, value_name = "URL")]
    pub publish: Option<String>,
    /// Rig file with motion limits and what is refused
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
    /// Stream so many setpoints a second while a prediction is executed
    #[arg(long, value_name = "HZ")]
    pub stream_hz: Option<f64>,
    /// Play a recording so many times as fast as it was made; 0: as fast as it can be read
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    pub rate: f64,
    /// Play a recording again and again
    #[arg(long)]
    pub repeat: bool,
    /// Write frames and results to a new MCAP file, for Foxglove and rerun; it grows by up to 20 MB/s
    /// at 640x480 and 30 Hz. (In a program that was built with --features view.)
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Serve frames and results to Foxglove through a WebSocket. Anyone who reaches that address sees
    /// what the camera sees, a web page only if it is this host's, HOST's or Foxglove's. (In a program
    /// that was built with --features view.)
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = "127.0.0.1:8765")]
    pub view: Option<String>,
}

#[derive(Debug, Args)]
pub struct CommandArgs {
    #[command(subcommand)]
    pub action: ServiceAction,
    /// LCM network of the service
    #[arg(long, global = true, value_name = "URL", default_value = linkage_lcm::DEFAULT_URL)]
    pub publish: String,
    /// Seconds to wait for its answer
    #[arg(long, global = true, value_name = "S", default_value_t = 10.0)]
    pub wait: f64,
    /// Key that signs the command, where the service's rig asks for one
    #[arg(long, global = true, value_name = "FILE")]
    pub key: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct ListenArgs {
    /// LCM network of the service
    #[arg(long, value_name = "URL", default_value = linkage_lcm::DEFAULT_URL)]
    pub publish: String,
    /// End after so many seconds; else Ctrl-C ends it
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// Print every message, not only those that say something new
    #[arg(long)]
    pub all: bool,
}

#[derive(Debug, Subcommand)]
pub enum ServiceAction {
    /// Watch how a person moves an object
    Start {
        /// The name that it gets
        object: String,
    },
    /// The person is done: learn
    Finish,
    /// Look for an object, or for anything known, and follow it
    Recognise {
        /// Its name
        object: Option<String>,
    },
    /// Plan an object's motion from where it is
    Predict {
        /// Its name; anything known where none is given
        object: Option<String>,
        /// Joint to move; all that are seen where none is named
        #[arg(long, value_name = "NAME")]
        joint: Option<String>,
        /// open, closed, or a configuration in radians or metres
        #[arg(long, default_value = "open", value_name = "TARGET", allow_hyphen_values = true)]
        to: String,
        /// Allow a target outside the range that was seen, by at most a turn or a metre
        #[arg(long)]
        outside_range: bool,
        /// What the gripper holds now, camera frame, metres; else where the demonstrator's hand was
        #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
        grasp: Option<Vec<f64>>,
    },
    /// Stop whatever is being done
    Cancel,
}

#[derive(Debug, Args)]
pub struct RecordArgs {
    /// Where frames come from, as for learn
    #[arg(long, value_name = "SOURCE")]
    pub source: String,
    #[command(flatten)]
    pub take: SourceArgs,
    /// A new folder; a new file for lcm-log and mcap
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How it is written
    #[arg(long, value_enum, default_value_t = RecordFormat::Tum)]
    pub format: RecordFormat,
}

/// How a recording is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum RecordFormat {
    /// Folder in the TUM layout, PNG
    Tum,
    /// The same with JPEG colour
    TumJpeg,
    /// LCM event log of kinect.frame_msg_t
    LcmLog,
    /// MCAP file of ROS 2 messages: JPEG colour, depth as it is, the camera
    Mcap,
    /// Folder that fakenect plays; depth as disparities of 11 bits
    Fakenect,
}

#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// Where frames come from, as for learn
    pub source: String,
    #[command(flatten)]
    pub take: SourceArgs,
    /// LCM network to send to
    #[arg(long, value_name = "URL", default_value = linkage_lcm::DEFAULT_URL)]
    pub publish: String,
    /// Channel to send on
    #[arg(long, value_name = "NAME", default_value = linkage_driver::lcm::DEFAULT_CHANNEL)]
    pub channel: String,
    /// So many times as fast as it was recorded; 0: as fast as it can be read
    #[arg(long, value_name = "X", default_value_t = 1.0)]
    pub rate: f64,
    /// JPEG colour, a sixth of the bytes
    #[arg(long)]
    pub jpeg: bool,
}

#[derive(Debug, Args)]
pub struct FitArgs {
    /// Pose logs: "x y z", "x y z qx qy qz qw" or "t x y z qx qy qz qw", or as a first line names it
    #[arg(required = true)]
    pub logs: Vec<PathBuf>,
    /// What the columns hold, where neither names nor their number tell it: t,x,y,z,qx,qy,qz,qw, and
    /// _ for a column that is not used
    #[arg(long, value_name = "NAMES")]
    pub columns: Option<Columns>,
    /// Write linkage.model/1, an array for several logs; - for standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct StoreArgs {
    #[command(subcommand)]
    pub action: StoreAction,
}

#[derive(Debug, Subcommand)]
pub enum StoreAction {
    /// Names of all objects
    List {
        /// The store
        #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
        store: PathBuf,
    },
    /// An object's model as JSON, and where it was learned
    Show {
        /// Its name
        object: String,
        /// The store
        #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
        store: PathBuf,
    },
    /// Take an object out
    Remove {
        /// Its name
        object: String,
        /// The store
        #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
        store: PathBuf,
    },
    /// Put all objects of other stores into this one, all or none
    Merge {
        /// The other stores
        #[arg(required = true)]
        from: Vec<PathBuf>,
        /// Put them in the place of other objects of their names
        #[arg(long)]
        replace: bool,
        /// The store
        #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
        store: PathBuf,
    },
}

#[derive(Debug, Args)]
pub struct ExportArgs {
    /// Name of the object
    pub object: String,
    /// json: linkage.model/1; urdf, sdf, mjcf, usd (text): links of boxes that keep apart over the
    /// joints' ranges, joints with the range that was seen (screws in sdf alone), z up
    #[arg(long, default_value = "json")]
    pub format: ExportFormat,
    /// File; standard output where none is named
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Show the surface that was seen, as OBJ files with colours in a folder NAME_meshes beside --out
    #[arg(long, requires = "out")]
    pub mesh: bool,
    /// The store
    #[arg(long, default_value = DEFAULT_STORE, value_name = "FILE")]
    pub store: PathBuf,
    /// Rig file with the velocities that joints may have
    #[arg(long, value_name = "FILE")]
    pub rig: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ExportFormat {
    Json,
    Urdf,
    Sdf,
    Mjcf,
    Usd,
}

#[derive(Debug, Args)]
pub struct SimulateArgs {
    /// Scene; "list" names all
    #[arg(long, value_name = "NAME")]
    pub scene: String,
    /// Folder of the recording
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Render an encounter: nobody there, another viewpoint and configuration
    #[arg(long)]
    pub encounter: bool,
    /// Stick an AprilTag (36h11) on each part and write tags.toml
    #[arg(long)]
    pub tags: bool,
    /// Surfaces of thing, room and person
    #[arg(long, value_enum, default_value_t = Surfaces::Speckled, value_name = "KIND")]
    pub surfaces: Surfaces,
}

#[derive(Debug, Args)]
pub struct VocabularyArgs {
    /// File to write; built in from skill/assets/vocabulary-2.bin
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Where its pictures are rendered to and kept
    #[arg(long, default_value = "out/vocabulary", value_name = "DIR")]
    pub work: PathBuf,
}

#[derive(Debug, Args)]
pub struct DoctorArgs {
    /// LCM network to test
    #[arg(long, value_name = "URL")]
    pub url: Option<String>,
    /// Measure this source for five seconds
    #[arg(long, value_name = "SOURCE")]
    pub source: Option<String>,
    #[command(flatten)]
    pub take: SourceArgs,
}

#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    pub action: ConfigAction,
}

#[derive(Debug, Subcommand)]
pub enum ConfigAction {
    /// Print it as TOML
    Dump,
}

#[derive(Debug, Args)]
pub struct LearnArgs {
    /// Demonstrations of one object: a recording (a folder, .mcap, .bag or .db3), mcap:, bag: or
    /// rosbag2: with #COLOR_TOPIC,DEPTH_TOPIC behind it, oni:FILE, lcmlog:FILE[#CHANNEL],
    /// lcm:URL[#CHANNEL], freenect:N, openni2:URI or v4l:COLOUR,DEPTH
    #[arg(required = true)]
    pub sources: Vec<String>,
    #[command(flatten)]
    pub take: SourceArgs,
    /// Name of the object
    #[arg(long)]
    pub object: String,
    /// Store to put the object into [default: objects.linkage, where recognise looks too]
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// Put it in the place of the stored object of that name
    #[arg(long)]
    pub replace: bool,
    /// Add the demonstration to the stored object of that name, if there is one
    #[arg(long, conflicts_with = "replace")]
    pub add: bool,
    /// Store nothing: only write the files that are asked for
    #[arg(long, conflicts_with_all = ["store", "replace", "add"])]
    pub no_store: bool,
    /// Write the model as JSON (linkage.model/1); - for standard output
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Write the pose of each part in each frame
    #[arg(long, value_name = "FILE.csv")]
    pub poses: Option<PathBuf>,
    /// Write a trajectory of each part into this folder, as `timestamp tx ty tz qx qy qz qw`
    /// (TUM's format, which evo reads): base.txt, part1.txt, …, in the camera frame
    #[arg(long, value_name = "DIR")]
    pub tum: Option<PathBuf>,
    /// Write the first demonstration and what was learned from it to a new MCAP file, for Foxglove and
    /// rerun; it takes up to 20 MB for each second of the demonstration at 640x480 and 30 Hz. (In a
    /// program that was built with --features view.)
    #[arg(long, value_name = "FILE")]
    pub mcap: Option<PathBuf>,
    /// Write a page to look at: the joints in words, what was refused and why, the motion in
    /// pictures, the numbers
    #[arg(long, value_name = "FILE.html")]
    pub report: Option<PathBuf>,
    /// Learn from nothing that lies on an AprilTag; tags.toml beside the recording says where
    /// they are
    #[arg(long)]
    pub tags: bool,
    /// With --tags: write each part's poses by its tag
    #[arg(long, value_name = "FILE.csv", requires = "tags")]
    pub tag_poses: Option<PathBuf>,
}

#[derive(Debug, Args)]
pub struct BenchArgs {
    /// dir: score every recording of a folder; paper: the paper's experiment, 43 demonstrations by the baseline's, the
    /// paper's and our way; ablation: what each of our choices is worth on a folder of recordings; recognise: look for
    /// learned things in stills, known ones and look-alikes (other rooms and shots by --seed), and in libraries of up
    /// to 100 000; false-reports: look for the objects of a store in recordings that do not show them (a recording
    /// shows the object whose name its own begins with); follow: follow what was learned from a recording through it;
    /// serve: time from the end of a demonstration to its model over LCM and from a frame to its prediction, and how a
    /// stream of setpoints keeps its time; soak: memory of a service that is used for long; logs: fit pose logs of
    /// known type; tracking: play clips forward and back
    #[arg(long, default_value = "dir")]
    pub suite: String,
    /// Folder of recordings, logs or clips; for paper and recognise: where recordings
    /// are rendered to and kept [default there: out/paper, out/recognise]
    pub dir: Option<PathBuf>,
    /// dir, paper: score against AprilTags instead of exact truth; tags.toml beside a recording
    /// says where they are
    #[arg(long)]
    pub tags: bool,
    /// paper, recognise: surfaces of thing, room and person; other than speckled, results are told by texture class
    #[arg(long, value_enum, default_value_t = Surfaces::Speckled, value_name = "KIND")]
    pub surfaces: Surfaces,
    /// paper: learn in this way alone, by the name of its profile
    #[arg(long, value_name = "PROFILE", value_parser = ["katz", "paper", "default"])]
    pub only: Option<String>,
    /// recognise: without ablation and without large libraries
    #[arg(long)]
    pub brief: bool,
    /// recognise: keep what is learned in this store, one for each --seed, and take from it what
    /// is there already, so that recognition is compared on the same models; false-reports: the objects
    /// to look for
    #[arg(long, value_name = "FILE")]
    pub store: Option<PathBuf>,
    /// false-reports: stills of each recording, evenly spread
    #[arg(long, value_name = "N", default_value_t = 3)]
    pub stills: usize,
    /// recognise: the largest library that is written to a store too, and opened from it; 10 000
    /// objects take 1 GB of the folder for temporary files
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    pub largest_store: usize,
    /// soak: so long, 30 frames a second
    #[arg(long, default_value_t = 60.0)]
    pub minutes: f64,
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}
