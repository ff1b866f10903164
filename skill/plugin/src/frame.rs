//! A caller's frame: colour and depth in buffers of its own.

use crate::boundary::{Failure, given};
use linkage_driver::{ColorImage, DepthImage, PinholeCamera, RgbdFrame};
use std::sync::Arc;

/// A pinhole camera, in pixels; the centre of the top-left pixel is (0, 0).
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_camera {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, column.
    pub cx: f64,
    /// Principal point, row.
    pub cy: f64,
    /// Brown's k1 k2 p1 p2 k3, as OpenCV has it; zeros for none.
    pub distortion: [f64; 5],
}

/// How depth is given; registered to colour either way.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum linkage_depth_format {
    /// uint16_t, millimetres, 0 where there is no reading.
    MillimetresU16 = 0,
    /// float, metres, 0 or NaN where there is no reading.
    MetresF32 = 1,
}

/// A frame. Its buffers are read during the call alone.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_frame {
    /// When it was taken, microseconds; later than the frame before it.
    pub utime: i64,
    /// Of colour and depth.
    pub camera: linkage_camera,
    /// Red, green, blue, 8 bits each, the top row first.
    pub rgb: *const u8,
    /// Bytes from row to row.
    pub rgb_stride: usize,
    /// Depth along the optical axis, the top row first.
    pub depth: *const std::ffi::c_void,
    /// Bytes from row to row.
    pub depth_stride: usize,
    /// One of linkage_depth_format.
    pub depth_format: u32,
}

/// Columns or rows of a picture at most.
const LARGEST: u32 = 8192;

/// Copies a caller's frame.
///
/// # Safety
/// Null, or a frame whose buffers hold as many rows of as many bytes as it says.
pub(crate) unsafe fn taken(frame: *const linkage_frame) -> Result<RgbdFrame, Failure> {
    // SAFETY: the caller of this function promises it.
    let frame = unsafe { given(frame, "frame") }?;
    let c = &frame.camera;
    if !(1..=LARGEST).contains(&c.width) || !(1..=LARGEST).contains(&c.height) {
        let size = format!("{}x{}", c.width, c.height);
        return Err(Failure::bad(format!("a picture of {size} pixels; 1 to {LARGEST} are known")));
    }
    let (width, height) = (c.width as usize, c.height as usize);
    let camera = PinholeCamera {
        width,
        height,
        fx: c.fx,
        fy: c.fy,
        cx: c.cx,
        cy: c.cy,
        depth_units_per_metre: 1000.0,
        distortion: PinholeCamera::brown(c.distortion),
        ..PinholeCamera::kinect()
    };
    camera.check().map_err(Failure::bad)?;
    // SAFETY: the caller of this function promises it.
    let rgb = unsafe { rows(frame.rgb, frame.rgb_stride, 3 * width, height, "rgb") }?;
    let color = ColorImage::new(width, height, rgb).map_err(Failure::bad)?;
    let bytes_of = |pixel: usize| {
        // SAFETY: the caller of this function promises it.
        unsafe { rows(frame.depth.cast(), frame.depth_stride, pixel * width, height, "depth") }
    };
    let metres: Vec<f32> = if frame.depth_format == linkage_depth_format::MillimetresU16 as u32 {
        let bytes = bytes_of(2)?;
        let values = bytes.chunks_exact(2).map(|b| u16::from_ne_bytes([b[0], b[1]]));
        values.map(|mm| f32::from(mm) / 1000.0).collect()
    } else if frame.depth_format == linkage_depth_format::MetresF32 as u32 {
        let bytes = bytes_of(4)?;
        bytes.chunks_exact(4).map(|b| f32::from_ne_bytes([b[0], b[1], b[2], b[3]])).collect()
    } else {
        return Err(Failure::bad(format!("depth_format {} is none", frame.depth_format)));
    };
    let depth = DepthImage::from_metres(width, height, metres).map_err(Failure::bad)?;
    RgbdFrame::new(frame.utime, Arc::new(camera), color, depth).map_err(Failure::bad)
}

/// Rows of a picture without what lies between them.
///
/// # Safety
/// Null, or valid for reads of `height - 1` strides and one row.
unsafe fn rows(
    buffer: *const u8,
    stride: usize,
    row: usize,
    height: usize,
    what: &str,
) -> Result<Vec<u8>, Failure> {
    if buffer.is_null() {
        return Err(Failure::bad(format!("{what} is NULL")));
    }
    if stride < row {
        let why = format!("{what}_stride is {stride}; a row has {row} bytes");
        return Err(Failure::bad(why));
    }
    let mut bytes = Vec::with_capacity(row * height);
    for v in 0..height {
        // SAFETY: not null; row `v` begins `v` strides into the buffer and has `row` bytes, which
        // the caller of this function promises to be there. Bytes have no alignment.
        bytes.extend_from_slice(unsafe { std::slice::from_raw_parts(buffer.add(v * stride), row) });
    }
    Ok(bytes)
}
