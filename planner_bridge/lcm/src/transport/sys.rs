//! The only unsafe code of this crate: calls into liblcm.

use super::Packet;
use std::collections::VecDeque;
use std::ffi::{CStr, CString, c_char, c_void};
use std::time::Duration;

#[allow(non_camel_case_types, non_upper_case_globals, non_snake_case, dead_code, missing_docs)]
mod ffi {
    include!(concat!(env!("OUT_DIR"), "/liblcm.rs"));
}

/// Packets that wait at most; more push out the oldest.
const MAX_WAITING: usize = 1024;

/// Owns an `lcm_t` and the queue that its callbacks fill.
pub struct Handle {
    lcm: *mut ffi::lcm_t,
    // Callbacks hold the queue's address: it must not move with the Handle.
    #[allow(clippy::box_collection)]
    queue: Box<VecDeque<Packet>>,
    subscriptions: usize,
}

// SAFETY: liblcm's functions may be called from any thread; a Handle is owned by one thread
// at a time, and receiving, which fills the queue, needs it exclusively.
unsafe impl Send for Handle {}

impl Handle {
    pub fn create(url: &str) -> Option<Self> {
        let url = CString::new(url).ok()?;
        // SAFETY: `url` is a NUL-terminated string that outlives the call.
        let lcm = unsafe { ffi::lcm_create(url.as_ptr()) };
        (!lcm.is_null()).then(|| Self { lcm, queue: Box::default(), subscriptions: 0 })
    }

    pub fn publish(&self, channel: &CStr, bytes: &[u8]) -> bool {
        let Ok(length) = u32::try_from(bytes.len()) else { return false };
        // SAFETY: `lcm` lives until our Drop; `bytes` holds `length` bytes, which liblcm
        // copies before it returns.
        unsafe {
            ffi::lcm_publish(self.lcm, channel.as_ptr(), bytes.as_ptr().cast::<c_void>(), length)
                == 0
        }
    }

    pub fn subscribe(&mut self, channel: &CStr) -> Option<usize> {
        let queue: *mut VecDeque<Packet> = &mut *self.queue;
        // SAFETY: the queue is boxed, so its address holds until our Drop, which destroys
        // `lcm`, and every subscription with it, first.
        let subscription = unsafe {
            ffi::lcm_subscribe(self.lcm, channel.as_ptr(), Some(receive), queue.cast::<c_void>())
        };
        if subscription.is_null() {
            return None;
        }
        // SAFETY: the subscription was just made and is not freed before `lcm`.
        unsafe { ffi::lcm_subscription_set_queue_capacity(subscription, MAX_WAITING as i32) };
        self.subscriptions += 1;
        Some(self.subscriptions)
    }

    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Packet>, ()> {
        if let Some(packet) = self.queue.pop_front() {
            return Ok(Some(packet));
        }
        let milliseconds = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX);
        // SAFETY: `lcm` lives until our Drop; callbacks run inside this call, while we hold
        // the queue exclusively through `&mut self`.
        let status = unsafe { ffi::lcm_handle_timeout(self.lcm, milliseconds) };
        if status < 0 { Err(()) } else { Ok(self.queue.pop_front()) }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: `lcm` came from lcm_create and is destroyed once.
        unsafe { ffi::lcm_destroy(self.lcm) };
    }
}

unsafe extern "C" fn receive(
    buffer: *const ffi::lcm_recv_buf_t,
    channel: *const c_char,
    user: *mut c_void,
) {
    // SAFETY: liblcm passes a valid buffer of `data_size` bytes and a NUL-terminated channel;
    // `user` is the queue of the Handle inside whose `receive` we are.
    let (queue, channel, bytes, received_utime) = unsafe {
        let buffer = &*buffer;
        let bytes = if buffer.data_size == 0 {
            &[][..]
        } else {
            std::slice::from_raw_parts(buffer.data.cast::<u8>(), buffer.data_size as usize)
        };
        (&mut *user.cast::<VecDeque<Packet>>(), CStr::from_ptr(channel), bytes, buffer.recv_utime)
    };
    if queue.len() >= MAX_WAITING {
        queue.pop_front();
    }
    queue.push_back(Packet {
        channel: channel.to_string_lossy().into_owned(),
        bytes: bytes.to_vec(),
        received_utime,
    });
}
