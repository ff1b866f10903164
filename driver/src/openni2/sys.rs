//! Calls into OpenNI2: the only unsafe code of this source.

use super::idle::Threads;
use openni2_sys as ffi;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::ptr;
use std::sync::OnceLock;
use std::time::Duration;

/// The interface's version that the bindings were made from: 2.2.
const API_VERSION: c_int = 2002;
/// Size that is asked of live devices.
const SIZE: (c_int, c_int) = (640, 480);
const FRAMES_PER_SECOND: c_int = 30;
/// A recording's thread walks the list of streams without a lock, over and over while one runs;
/// once all are stopped it looks at them every 10 ms, and they can be taken away between.
const UNTIL_IDLE: Duration = Duration::from_millis(50);
/// Longest time that a thread in the middle of its work is waited for, beyond that.
const LONGEST_WORK: Duration = Duration::from_secs(3);
/// Playback speed that waits for the reader.
const MANUAL_SPEED: f32 = -1.0;

/// Which of the two pictures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sensor {
    /// Colour.
    Color = 0,
    /// Depth.
    Depth = 1,
}

/// One picture.
#[derive(Debug)]
pub struct Picture {
    /// The device's time, microseconds from its start.
    pub utime: i64,
    /// Its number, from 1 on.
    pub number: usize,
    pub width: usize,
    pub height: usize,
    /// RGB, or 16 bits of depth a pixel; never mirrored.
    pub bytes: Vec<u8>,
    /// Units in a metre of depth.
    pub units_per_metre: f64,
}

/// Initialises the library, once. It is never shut down: that would unload its drivers while
/// their threads still run.
fn initialise() -> Result<(), String> {
    static DONE: OnceLock<Result<(), String>> = OnceLock::new();
    DONE.get_or_init(|| {
        // SAFETY: may be called at any time, from any thread.
        let status = unsafe { ffi::oniInitialize(API_VERSION) };
        if status == ffi::OniStatus_ONI_STATUS_OK {
            Ok(())
        } else {
            Err(format!("OpenNI2 does not start: {}", last_error()))
        }
    })
    .clone()
}

/// An open device with both streams running.
pub struct Device {
    device: ffi::OniDeviceHandle,
    streams: [ffi::OniStreamHandle; 2],
    optics: [Optics; 2],
    recorded: [usize; 2],
    is_mirrored: [bool; 2],
    /// Those that the library started for it.
    threads: Threads,
}

/// What a stream tells of its lens.
#[derive(Debug, Clone, Copy, Default)]
pub struct Optics {
    /// Columns and rows.
    pub size: (usize, usize),
    /// Horizontal and vertical, radians.
    pub field_of_view: [f64; 2],
}

/// What a device says of whose pixels depth comes in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Registered {
    /// The colour camera's.
    Yes,
    /// The infrared camera's.
    No,
    /// It does not say, as recordings do not.
    Untold,
}

// SAFETY: OpenNI2's functions may be called from any thread; a Device is owned by one at a
// time.
unsafe impl Send for Device {}

/// URI and name of every device.
///
/// # Errors
/// When the library does not start.
pub fn list_devices() -> Result<Vec<(String, String)>, String> {
    initialise()?;
    let (mut list, mut count) = (ptr::null_mut(), 0);
    // SAFETY: both places are valid; the list is read before it is released.
    unsafe {
        if ffi::oniGetDeviceList(&mut list, &mut count) != ffi::OniStatus_ONI_STATUS_OK {
            return Err(last_error());
        }
        let devices = (0..count as usize)
            .map(|i| {
                let info = &*list.add(i);
                (
                    text(info.uri.as_ptr()),
                    format!("{} {}", text(info.vendor.as_ptr()), text(info.name.as_ptr())),
                )
            })
            .collect();
        ffi::oniReleaseDeviceList(list);
        Ok(devices)
    }
}

impl Device {
    /// Opens a device, any where the URI is empty, and starts both streams.
    pub fn open(uri: &str) -> Result<Self, String> {
        let mut device = Self::without_streams(uri)?;
        device.register();
        device.start_both()?;
        Ok(device)
    }

    /// Opens a recording and starts both streams. It waits for the reader, and ends at its end.
    ///
    /// A recording plays from when it is opened, on a thread that looks at the streams without a
    /// lock: unless it waits already, a stream that is added then may crash it.
    pub fn open_recording(uri: &str) -> Result<Self, String> {
        let mut device = Self::without_streams(uri)?;
        device.play_manually()?;
        device.start_both()?;
        Ok(device)
    }

    /// Plays a recording from its beginning. It is closed first: who opens one twice gets the same
    /// device, which goes on.
    pub fn replay(&mut self, uri: &str) -> Result<(), String> {
        self.close();
        *self = Self::open_recording(uri)?;
        Ok(())
    }

    /// Gives back every handle, if that was not done.
    fn close(&mut self) {
        let device = std::mem::replace(&mut self.device, ptr::null_mut());
        let streams = std::mem::replace(&mut self.streams, [ptr::null_mut(); 2]);
        if device.is_null() {
            return;
        }
        let streams = || streams.into_iter().filter(|s| !s.is_null());
        // SAFETY: every handle came from the library and is given back once, streams first.
        unsafe {
            streams().for_each(|stream| ffi::oniStreamStop(stream));
            std::thread::sleep(UNTIL_IDLE);
            self.threads.wait_until_idle(LONGEST_WORK);
            streams().for_each(|stream| ffi::oniStreamDestroy(stream));
            ffi::oniDeviceClose(device);
        }
    }

    fn without_streams(uri: &str) -> Result<Self, String> {
        initialise()?;
        let uri = CString::new(uri).map_err(|_| "the name holds a NUL".to_owned())?;
        let any = uri.is_empty();
        let mut device = ptr::null_mut();
        let address = if any { ptr::null() } else { uri.as_ptr() };
        // SAFETY: the URI is NUL-terminated or null, which stands for any device; `device` is
        // a valid place.
        let open = || unsafe { ffi::oniDeviceOpen(address, &mut device) };
        let (status, threads) = Threads::begun_by(open);
        if status != ffi::OniStatus_ONI_STATUS_OK || device.is_null() {
            return Err(format!("OpenNI2 cannot open it: {}", last_error()));
        }
        Ok(Self {
            device,
            streams: [ptr::null_mut(); 2],
            optics: [Optics::default(); 2],
            recorded: [0; 2],
            is_mirrored: [false; 2],
            threads,
        })
    }

    fn start_both(&mut self) -> Result<(), String> {
        [Sensor::Color, Sensor::Depth].into_iter().try_for_each(|sensor| self.start(sensor))
    }

    /// Asks for depth in the colour camera's pixels, where the device can.
    fn register(&self) {
        let mode = ffi::OniImageRegistrationMode_ONI_IMAGE_REGISTRATION_DEPTH_TO_COLOR;
        // SAFETY: the device is open; the property is an int.
        unsafe {
            if ffi::oniDeviceIsImageRegistrationModeSupported(self.device, mode) != 0 {
                let value = mode as c_int;
                let property = ffi::ONI_DEVICE_PROPERTY_IMAGE_REGISTRATION as c_int;
                set(
                    |data, size| ffi::oniDeviceSetProperty(self.device, property, data, size),
                    value,
                );
            }
            ffi::oniDeviceEnableDepthColorSync(self.device);
        }
    }

    fn start(&mut self, sensor: Sensor) -> Result<(), String> {
        let (kind, what) = match sensor {
            Sensor::Color => (ffi::OniSensorType_ONI_SENSOR_COLOR, "colour"),
            Sensor::Depth => (ffi::OniSensorType_ONI_SENSOR_DEPTH, "depth"),
        };
        let mut stream = ptr::null_mut();
        // SAFETY: the device is open, the stream a valid place; properties are written at the
        // sizes that their types have.
        unsafe {
            if ffi::oniDeviceGetSensorInfo(self.device, kind).is_null() {
                return Err(format!("it has no {what} stream; both colour and depth are needed"));
            }
            if ffi::oniDeviceCreateStream(self.device, kind, &mut stream)
                != ffi::OniStatus_ONI_STATUS_OK
            {
                return Err(format!("no {what} stream: {}", last_error()));
            }
        }
        self.streams[sensor as usize] = stream;
        self.choose_mode(stream, kind);
        let mode: ffi::OniVideoMode = get(stream, ffi::ONI_STREAM_PROPERTY_VIDEO_MODE as c_int)
            .ok_or_else(|| format!("the {what} stream does not tell its format"))?;
        self.optics[sensor as usize] = optics(stream, &mode);
        let recorded = get::<c_int>(stream, ffi::ONI_STREAM_PROPERTY_NUMBER_OF_FRAMES as c_int);
        self.recorded[sensor as usize] = recorded.map_or(0, |n| n.max(0) as usize);
        // SAFETY: the stream was just made.
        if unsafe { ffi::oniStreamStart(stream) } != ffi::OniStatus_ONI_STATUS_OK {
            return Err(format!("the {what} stream does not start: {}", last_error()));
        }
        Ok(())
    }

    /// Asks for 640x480, RGB and millimetres, unmirrored; recordings are as they are.
    fn choose_mode(&self, stream: ffi::OniStreamHandle, kind: ffi::OniSensorType) {
        let format = if kind == ffi::OniSensorType_ONI_SENSOR_COLOR {
            ffi::OniPixelFormat_ONI_PIXEL_FORMAT_RGB888
        } else {
            ffi::OniPixelFormat_ONI_PIXEL_FORMAT_DEPTH_1_MM
        };
        let mode = ffi::OniVideoMode {
            pixelFormat: format,
            resolutionX: SIZE.0,
            resolutionY: SIZE.1,
            fps: FRAMES_PER_SECOND,
        };
        // SAFETY: the stream is open; each property has the type that is written.
        unsafe {
            let property = ffi::ONI_STREAM_PROPERTY_VIDEO_MODE as c_int;
            set(|data, size| ffi::oniStreamSetProperty(stream, property, data, size), mode);
            let property = ffi::ONI_STREAM_PROPERTY_MIRRORING as c_int;
            set(|data, size| ffi::oniStreamSetProperty(stream, property, data, size), 0 as c_int);
        }
    }

    fn play_manually(&mut self) -> Result<(), String> {
        // SAFETY: the device is open; the properties are a float and an int.
        let done = unsafe {
            let speed = ffi::ONI_DEVICE_PROPERTY_PLAYBACK_SPEED as c_int;
            let repeat = ffi::ONI_DEVICE_PROPERTY_PLAYBACK_REPEAT_ENABLED as c_int;
            set(
                |data, size| ffi::oniDeviceSetProperty(self.device, speed, data, size),
                MANUAL_SPEED,
            ) && set(
                |data, size| ffi::oniDeviceSetProperty(self.device, repeat, data, size),
                0 as c_int,
            )
        };
        if done { Ok(()) } else { Err(format!("it cannot be played: {}", last_error())) }
    }

    /// What a stream tells of its lens.
    pub fn optics(&self, sensor: Sensor) -> Optics {
        self.optics[sensor as usize]
    }

    /// True where a stream's last picture came mirrored and was turned back.
    pub fn is_mirrored(&self, sensor: Sensor) -> bool {
        self.is_mirrored[sensor as usize]
    }

    /// What the device says of registration.
    pub fn registered(&self) -> Registered {
        let (mut mode, mut size): (c_int, c_int) = (0, size_of::<c_int>() as c_int);
        // SAFETY: the device is open; the property is an int, and no more is written than `size`
        // says.
        let status = unsafe {
            ffi::oniDeviceGetProperty(
                self.device,
                ffi::ONI_DEVICE_PROPERTY_IMAGE_REGISTRATION as c_int,
                (&raw mut mode).cast(),
                &mut size,
            )
        };
        let to_color = ffi::OniImageRegistrationMode_ONI_IMAGE_REGISTRATION_DEPTH_TO_COLOR as c_int;
        match status {
            ffi::OniStatus_ONI_STATUS_OK if mode == to_color => Registered::Yes,
            ffi::OniStatus_ONI_STATUS_OK => Registered::No,
            _ => Registered::Untold,
        }
    }

    /// Pictures in a recording; 0 for a live device.
    pub fn recorded(&self, sensor: Sensor) -> usize {
        self.recorded[sensor as usize]
    }

    /// Waits for a picture of either stream.
    pub fn wait(&mut self, timeout: Duration) -> Result<Option<Sensor>, String> {
        let mut index = 0;
        let milliseconds = c_int::try_from(timeout.as_millis()).unwrap_or(c_int::MAX);
        // SAFETY: both streams run; `index` is a valid place.
        let status = unsafe {
            ffi::oniWaitForAnyStream(self.streams.as_mut_ptr(), 2, &mut index, milliseconds)
        };
        match status {
            ffi::OniStatus_ONI_STATUS_OK if index == 0 => Ok(Some(Sensor::Color)),
            ffi::OniStatus_ONI_STATUS_OK => Ok(Some(Sensor::Depth)),
            ffi::OniStatus_ONI_STATUS_TIME_OUT => Ok(None),
            _ => Err(format!("the device is lost: {}", last_error())),
        }
    }

    /// Reads the next picture of a stream; blocks until there is one. A mirrored one is turned
    /// back: not every device lets mirroring be switched off, and a recording is as it is.
    pub fn read(&mut self, sensor: Sensor) -> Result<Picture, String> {
        let stream = self.streams[sensor as usize];
        if stream.is_null() {
            return Err("it is closed".to_owned());
        }
        let mirroring = get::<c_int>(stream, ffi::ONI_STREAM_PROPERTY_MIRRORING as c_int);
        let is_mirrored = mirroring.is_some_and(|m| m != 0);
        self.is_mirrored[sensor as usize] = is_mirrored;
        let mut frame: *mut ffi::OniFrame = ptr::null_mut();
        // SAFETY: the stream runs; the frame is valid until it is released, and all that is
        // kept of it is copied before.
        unsafe {
            let status = ffi::oniStreamReadFrame(stream, &mut frame);
            if status != ffi::OniStatus_ONI_STATUS_OK || frame.is_null() {
                return Err(format!("a frame cannot be read: {}", last_error()));
            }
            let picture = copied(&*frame, is_mirrored);
            ffi::oniFrameRelease(frame);
            picture
        }
    }
}

impl Drop for Device {
    fn drop(&mut self) {
        self.close();
    }
}

/// Size and field of view of a stream; zeros where it does not tell.
fn optics(stream: ffi::OniStreamHandle, mode: &ffi::OniVideoMode) -> Optics {
    let angle = |property| get::<f32>(stream, property).map_or(0.0, f64::from);
    Optics {
        size: (mode.resolutionX.max(0) as usize, mode.resolutionY.max(0) as usize),
        field_of_view: [
            angle(ffi::ONI_STREAM_PROPERTY_HORIZONTAL_FOV as c_int),
            angle(ffi::ONI_STREAM_PROPERTY_VERTICAL_FOV as c_int),
        ],
    }
}

/// A frame's pixels, row by row without padding, and turned back where they are mirrored.
///
/// # Safety
/// The frame's data must hold `dataSize` bytes.
unsafe fn copied(frame: &ffi::OniFrame, is_mirrored: bool) -> Result<Picture, String> {
    let (pixel_bytes, units_per_metre) = match frame.videoMode.pixelFormat {
        ffi::OniPixelFormat_ONI_PIXEL_FORMAT_RGB888 => (3, 0.0),
        ffi::OniPixelFormat_ONI_PIXEL_FORMAT_DEPTH_1_MM => (2, 1e3),
        ffi::OniPixelFormat_ONI_PIXEL_FORMAT_DEPTH_100_UM => (2, 1e4),
        other => {
            return Err(format!("pixel format {other} is neither RGB nor depth in millimetres"));
        }
    };
    let (width, height) = (frame.width.max(0) as usize, frame.height.max(0) as usize);
    let row = width * pixel_bytes;
    let (stride, size) = (frame.stride.max(0) as usize, frame.dataSize.max(0) as usize);
    if width == 0
        || height == 0
        || stride < row
        || size < stride * (height - 1) + row
        || frame.data.is_null()
    {
        return Err(format!("a frame of {width}x{height} holds only {size} bytes"));
    }
    // SAFETY: the caller's contract.
    let data = unsafe { std::slice::from_raw_parts(frame.data.cast::<u8>(), size) };
    let rows = data.chunks(stride).take(height).map(|r| &r[..row]);
    let bytes = if is_mirrored {
        rows.flat_map(|r| r.rchunks_exact(pixel_bytes)).flatten().copied().collect()
    } else {
        rows.flatten().copied().collect()
    };
    Ok(Picture {
        utime: frame.timestamp as i64,
        number: frame.frameIndex.max(0) as usize,
        width,
        height,
        bytes,
        units_per_metre,
    })
}

/// Sets a property through one of the library's setters; true when it took it.
fn set<T>(setter: impl FnOnce(*const c_void, c_int) -> ffi::OniStatus, value: T) -> bool {
    setter((&raw const value).cast(), size_of::<T>() as c_int) == ffi::OniStatus_ONI_STATUS_OK
}

/// A property of a stream; `T` is plain data of the size that the property has.
fn get<T: Copy>(stream: ffi::OniStreamHandle, property: c_int) -> Option<T> {
    let mut value = std::mem::MaybeUninit::<T>::zeroed();
    let mut size = size_of::<T>() as c_int;
    // SAFETY: the stream is open; the library writes at most `size` bytes and tells how many.
    unsafe {
        let status =
            ffi::oniStreamGetProperty(stream, property, value.as_mut_ptr().cast(), &mut size);
        (status == ffi::OniStatus_ONI_STATUS_OK && size as usize == size_of::<T>())
            .then(|| value.assume_init())
    }
}

/// The library's text about its last failure on this thread.
fn last_error() -> String {
    // SAFETY: the library returns a NUL-terminated string that lives until its next call.
    let words = unsafe { text(ffi::oniGetExtendedError()) };
    if words.is_empty() { "it does not say why".to_owned() } else { words }
}

/// # Safety
/// Null or NUL-terminated.
unsafe fn text(chars: *const c_char) -> String {
    if chars.is_null() {
        return String::new();
    }
    // SAFETY: the caller's contract.
    let words = unsafe { CStr::from_ptr(chars) };
    words.to_string_lossy().split_whitespace().collect::<Vec<_>>().join(" ")
}
