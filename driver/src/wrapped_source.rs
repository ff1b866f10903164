//! A source whose frames are taken by a function, which may wait before a frame or look at it. In: a source.
//! Out: a source that is otherwise the same.

use crate::error::SourceError;
use crate::rgbd_source::RgbdSource;
use crate::statistics::SourceStatistics;
use linkage_frames::frame::RgbdFrame;

/// A source, and how its frames are taken. A wait for a frame has no end, also where one with an end
/// ([`RgbdSource::next_frame_within`]) is asked for: the function decides.
pub struct WrappedSource<F> {
    source: Box<dyn RgbdSource>,
    take: F,
}

impl<F> WrappedSource<F>
where
    F: FnMut(&mut dyn RgbdSource) -> Result<Option<RgbdFrame>, SourceError> + Send,
{
    /// Takes each frame of a source by a function.
    pub fn new(source: Box<dyn RgbdSource>, take: F) -> Self {
        Self { source, take }
    }
}

impl<F> RgbdSource for WrappedSource<F>
where
    F: FnMut(&mut dyn RgbdSource) -> Result<Option<RgbdFrame>, SourceError> + Send,
{
    fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
        (self.take)(&mut *self.source)
    }

    fn frame_count(&self) -> Option<usize> {
        self.source.frame_count()
    }

    fn name(&self) -> &str {
        self.source.name()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn statistics(&self) -> SourceStatistics {
        self.source.statistics()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use linkage_frames::{ColorImage, DepthImage, PinholeCamera};
    use std::sync::Arc;

    /// A camera that gives two frames of one pixel.
    struct TwoFrames(u64);

    impl RgbdSource for TwoFrames {
        fn next_frame(&mut self) -> Result<Option<RgbdFrame>, SourceError> {
            if self.0 == 2 {
                return Ok(None);
            }
            self.0 += 1;
            let camera =
                PinholeCamera { width: 1, height: 1, cx: 0.0, cy: 0.0, ..PinholeCamera::kinect() };
            let color = ColorImage::new(1, 1, vec![0; 3]).unwrap();
            let depth = DepthImage::from_metres(1, 1, vec![1.0]).unwrap();
            Ok(RgbdFrame::new(self.0 as i64, Arc::new(camera), color, depth).ok())
        }

        fn frame_count(&self) -> Option<usize> {
            Some(2)
        }

        fn name(&self) -> &str {
            "two frames"
        }

        fn is_live(&self) -> bool {
            true
        }

        fn statistics(&self) -> SourceStatistics {
            SourceStatistics { delivered: self.0, ..SourceStatistics::default() }
        }
    }

    #[test]
    fn each_frame_passes_the_function_and_all_else_is_told_by_the_source() {
        let mut passed = Vec::new();
        let mut wrapped = WrappedSource::new(Box::new(TwoFrames(0)), |source| {
            let frame = source.next_frame()?;
            passed.push(frame.as_ref().map(|frame| frame.utime));
            Ok(frame)
        });
        assert_eq!(wrapped.next_frame().unwrap().map(|frame| frame.utime), Some(1));
        assert_eq!(wrapped.next_frame().unwrap().map(|frame| frame.utime), Some(2));
        assert!(wrapped.next_frame().unwrap().is_none());
        assert_eq!((wrapped.name(), wrapped.is_live()), ("two frames", true));
        assert_eq!((wrapped.frame_count(), wrapped.statistics().delivered), (Some(2), 2));
        drop(wrapped);
        assert_eq!(passed, [Some(1), Some(2), None]);
    }

    #[test]
    fn a_function_may_keep_frames_back() {
        let mut wrapped = WrappedSource::new(Box::new(TwoFrames(0)), |source| {
            source.next_frame()?;
            source.next_frame()
        });
        assert_eq!(wrapped.next_frame().unwrap().map(|frame| frame.utime), Some(2));
        assert!(wrapped.next_frame().unwrap().is_none());
    }
}
