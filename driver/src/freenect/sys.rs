//! Calls into libfreenect: the only unsafe code of this source.

use crate::live::CameraFault;
use freenect_sys as ffi;
use std::collections::VecDeque;
use std::ffi::{c_int, c_void};
use std::ptr;
use std::time::Duration;

/// Columns and rows of both cameras' pictures.
pub const SIZE: (usize, usize) = (640, 480);

/// Pictures that wait to be taken; when more come, the oldest are dropped.
const WAITING: usize = 8;

/// What a camera of the device has delivered.
pub enum Pixels {
    /// RGB, top row first.
    Color(Vec<u8>),
    /// Millimetres, or disparities in playback.
    Depth(Vec<u16>),
}

/// A picture with the device's count.
pub struct Picture {
    pub ticks: u32,
    pub pixels: Pixels,
}

/// Where callbacks put pictures.
#[derive(Default)]
struct Inbox(VecDeque<Picture>);

impl Inbox {
    fn put(&mut self, picture: Picture) {
        if self.0.len() == WAITING {
            self.0.pop_front();
        }
        self.0.push_back(picture);
    }
}

/// An open device that streams; closed when dropped.
pub struct Device {
    context: *mut ffi::freenect_context,
    device: *mut ffi::freenect_device,
    /// Callbacks hold its address: it is boxed and outlives the device.
    inbox: Box<Inbox>,
    playback: bool,
}

// SAFETY: libfreenect keeps no thread-local state; a Device is used by one thread at a time,
// and its callbacks run inside `process_events` on that thread.
unsafe impl Send for Device {}

/// How many Kinects there are.
///
/// # Errors
/// When USB cannot be used.
pub fn device_count() -> Result<usize, String> {
    let context = Context::new()?;
    // SAFETY: the context is valid until dropped.
    let count = unsafe { ffi::freenect_num_devices(context.0) };
    usize::try_from(count).map_err(|_| format!("libfreenect cannot list devices ({count})"))
}

/// A context that is shut down when dropped.
struct Context(*mut ffi::freenect_context);

impl Context {
    fn new() -> Result<Self, String> {
        let mut context = ptr::null_mut();
        // SAFETY: `context` is a valid place for the new context; no USB context of our own.
        let status = unsafe { ffi::freenect_init(&mut context, ptr::null_mut()) };
        if status < 0 || context.is_null() {
            return Err(format!("libfreenect cannot use USB ({status})"));
        }
        // SAFETY: the context was just made; both calls only set values in it.
        unsafe {
            ffi::freenect_set_log_level(context, ffi::freenect_loglevel_FREENECT_LOG_ERROR);
            let camera = ffi::freenect_device_flags_FREENECT_DEVICE_CAMERA;
            ffi::freenect_select_subdevices(context, camera);
        }
        Ok(Self(context))
    }

    /// Hands the context to someone who shuts it down.
    fn into_raw(self) -> *mut ffi::freenect_context {
        let context = self.0;
        std::mem::forget(self);
        context
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        // SAFETY: the context came from freenect_init and is shut down once.
        unsafe { ffi::freenect_shutdown(self.0) };
    }
}

impl Device {
    /// Opens and starts a device; the error says what to do.
    pub fn open(index: i32) -> Result<Self, String> {
        let context = Context::new()?;
        // SAFETY: the context is valid until dropped.
        let count = unsafe { ffi::freenect_num_devices(context.0) };
        if count < 1 {
            return Err(
                "no Kinect is found; check USB and its own power supply, then run \"linkage doctor\""
                    .to_owned(),
            );
        }
        if index < 0 || index >= count {
            return Err(format!("there are {count} Kinects, counted from 0"));
        }
        let mut device = ptr::null_mut();
        // SAFETY: the context is valid and `device` a valid place for the new device.
        let status = unsafe { ffi::freenect_open_device(context.0, &mut device, index) };
        if status < 0 || device.is_null() {
            return Err(format!(
                "the Kinect cannot be opened ({status}): another program or the kernel's gspca_kinect holds it \
                 (\"sudo modprobe -r gspca_kinect\"), or you may not use it (udev rules of package libfreenect0.5, group plugdev)"
            ));
        }
        let mut opened =
            Self { context: context.into_raw(), device, inbox: Box::default(), playback: false };
        opened.start()?;
        Ok(opened)
    }

    fn start(&mut self) -> Result<(), String> {
        let registered =
            depth_mode(ffi::freenect_depth_format_FREENECT_DEPTH_REGISTERED).map(|m| (m, false));
        let (depth, playback) = registered
            .or_else(|| Some((depth_mode(ffi::freenect_depth_format_FREENECT_DEPTH_11BIT)?, true)))
            .ok_or("libfreenect offers no depth of 640x480")?;
        let color = color_mode().ok_or("libfreenect offers no colour of 640x480")?;
        self.playback = playback;
        let inbox: *mut Inbox = &mut *self.inbox;
        // SAFETY: the device is open; the modes are the library's own; the inbox is boxed and
        // lives until Drop, which stops the streams and closes the device first.
        let status = unsafe {
            ffi::freenect_set_user(self.device, inbox.cast::<c_void>());
            ffi::freenect_set_depth_callback(self.device, Some(on_depth));
            ffi::freenect_set_video_callback(self.device, Some(on_color));
            [
                ffi::freenect_set_depth_mode(self.device, depth),
                ffi::freenect_set_video_mode(self.device, color),
                ffi::freenect_start_depth(self.device),
                ffi::freenect_start_video(self.device),
            ]
        };
        match status.iter().find(|s| **s < 0) {
            Some(status) => Err(format!(
                "the Kinect does not stream ({status}): give it a USB port of its own; two cameras on one hub are too much"
            )),
            None => Ok(()),
        }
    }

    /// True where fakenect stands for the device.
    pub fn is_playback(&self) -> bool {
        self.playback
    }

    /// Lets the library work until something happens, at most this long.
    pub fn process_events(&mut self, timeout: Duration) -> Result<(), CameraFault> {
        let mut timeout = ffi::timeval {
            tv_sec: timeout.as_secs() as i64,
            tv_usec: i64::from(timeout.subsec_micros()),
        };
        // SAFETY: the context lives until Drop; callbacks run inside this call, while we hold
        // the inbox exclusively through `&mut self`.
        let status: c_int =
            unsafe { ffi::freenect_process_events_timeout(self.context, &mut timeout) };
        match status {
            0.. => Ok(()),
            _ if self.playback => Err(CameraFault::Ended),
            _ => Err(CameraFault::Lost(format!("USB transfers failed ({status})"))),
        }
    }

    /// True when no picture waits.
    pub fn is_idle(&self) -> bool {
        self.inbox.0.is_empty()
    }

    /// The oldest picture that waits.
    pub fn take_picture(&mut self) -> Option<Picture> {
        self.inbox.0.pop_front()
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        // SAFETY: both pointers came from the library and are given back once, device first.
        unsafe {
            ffi::freenect_stop_depth(self.device);
            ffi::freenect_stop_video(self.device);
            ffi::freenect_close_device(self.device);
            ffi::freenect_shutdown(self.context);
        }
    }
}

/// The mode of 640x480 for a depth format; fakenect knows disparities alone, and aborts when
/// it is asked for others.
fn depth_mode(format: ffi::freenect_depth_format) -> Option<ffi::freenect_frame_mode> {
    // SAFETY: both functions only read tables of the library; `i` is below the count.
    let modes = (0..unsafe { ffi::freenect_get_depth_mode_count() })
        .map(|i| unsafe { ffi::freenect_get_depth_mode(i) });
    modes.into_iter().find(|m| {
        // SAFETY: of a depth mode the union holds the depth format.
        is_medium(m) && unsafe { m.__bindgen_anon_1.depth_format } == format
    })
}

fn color_mode() -> Option<ffi::freenect_frame_mode> {
    // SAFETY: as in `depth_mode`.
    let modes = (0..unsafe { ffi::freenect_get_video_mode_count() })
        .map(|i| unsafe { ffi::freenect_get_video_mode(i) });
    modes.into_iter().find(|m| {
        // SAFETY: of a video mode the union holds the video format.
        let format = unsafe { m.__bindgen_anon_1.video_format };
        is_medium(m) && format == ffi::freenect_video_format_FREENECT_VIDEO_RGB
    })
}

fn is_medium(mode: &ffi::freenect_frame_mode) -> bool {
    mode.is_valid != 0
        && mode.resolution == ffi::freenect_resolution_FREENECT_RESOLUTION_MEDIUM
        && (mode.width as usize, mode.height as usize) == SIZE
}

/// # Safety
/// Called by libfreenect with the inbox as the device's user and a whole picture of depth.
unsafe extern "C" fn on_depth(device: *mut ffi::freenect_device, depth: *mut c_void, ticks: u32) {
    // SAFETY: per the contract; the picture is 640x480 of 16 bits, the mode that was set.
    let (inbox, raw) = unsafe {
        (
            &mut *ffi::freenect_get_user(device).cast::<Inbox>(),
            std::slice::from_raw_parts(depth.cast::<u16>(), SIZE.0 * SIZE.1),
        )
    };
    inbox.put(Picture { ticks, pixels: Pixels::Depth(raw.to_vec()) });
}

/// # Safety
/// As [`on_depth`], with a whole picture of colour.
unsafe extern "C" fn on_color(device: *mut ffi::freenect_device, rgb: *mut c_void, ticks: u32) {
    // SAFETY: per the contract; the picture is 640x480 of RGB, the mode that was set.
    let (inbox, rgb) = unsafe {
        (
            &mut *ffi::freenect_get_user(device).cast::<Inbox>(),
            std::slice::from_raw_parts(rgb.cast::<u8>(), SIZE.0 * SIZE.1 * 3),
        )
    };
    inbox.put(Picture { ticks, pixels: Pixels::Color(rgb.to_vec()) });
}
