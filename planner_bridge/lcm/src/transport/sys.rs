//! The only unsafe code of this crate: calls into liblcm, for `memq://`, `file://` and `tcpq://`.

use crate::packet::Packet;
use crate::subscriptions::Subscriptions;
use socket2::SockRef;
use std::collections::VecDeque;
use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::io;
use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

#[allow(non_camel_case_types, non_upper_case_globals, non_snake_case, dead_code, missing_docs)]
mod ffi {
    include!(concat!(env!("OUT_DIR"), "/liblcm.rs"));
}

/// Packets that wait at most; when more come, the oldest are dropped.
const MAX_WAITING: usize = 1024;
/// liblcm waits with `select`, which aborts the program for descriptors from here on.
const SELECT_LIMIT: c_int = 1024;

/// Owns an `lcm_t` and what its callbacks fill.
pub struct Handle {
    lcm: *mut ffi::lcm_t,
    // Callbacks hold its address: it must not move with the Handle.
    state: Box<State>,
}

/// What callbacks fill.
#[derive(Default)]
struct State {
    queue: VecDeque<Packet>,
    wanted: Subscriptions,
    received: u64,
    oversized: u64,
    refused: u64,
    pushed_out: u64,
}

// SAFETY: liblcm's functions may be called from any thread; a Handle is owned by one thread
// at a time, and receiving, which fills the state, needs it exclusively.
unsafe impl Send for Handle {}

impl Handle {
    /// Connects; `None` when liblcm cannot.
    pub fn create(url: &str) -> Option<Self> {
        let url = CString::new(url).ok()?;
        // SAFETY: `url` is a NUL-terminated string that outlives the call.
        let lcm = unsafe { ffi::lcm_create(url.as_ptr()) };
        if lcm.is_null() {
            return None;
        }
        // From here on dropping it destroys `lcm`.
        let handle = Self { lcm, state: Box::default() };
        handle.is_connected().then_some(handle)
    }

    pub fn publish(&self, channel: &CStr, bytes: &[u8]) -> bool {
        let Ok(length) = c_int::try_from(bytes.len()) else { return false };
        // SAFETY: `lcm` lives until our Drop; `bytes` holds `length` bytes, a number that is
        // positive as an int too, which liblcm copies before it returns.
        unsafe {
            let bytes = bytes.as_ptr().cast::<c_void>();
            ffi::lcm_publish(self.lcm, channel.as_ptr(), bytes, length as u32) == 0
        }
    }

    /// Receives messages of at most this many bytes on channels that match.
    pub fn subscribe(&mut self, channel: &str, max_bytes: usize) -> Result<(), String> {
        let name = CString::new(channel).map_err(|e| e.to_string())?;
        self.state.wanted.add(channel, max_bytes).map_err(|e| e.to_string())?;
        let state: *mut State = &mut *self.state;
        // SAFETY: the state is boxed, so its address holds until our Drop, which destroys
        // `lcm`, and every subscription with it, first.
        let subscription = unsafe {
            ffi::lcm_subscribe(self.lcm, name.as_ptr(), Some(receive), state.cast::<c_void>())
        };
        if subscription.is_null() {
            return Err("liblcm does not take it".to_owned());
        }
        // SAFETY: the subscription was just made and is not freed before `lcm`.
        unsafe { ffi::lcm_subscription_set_queue_capacity(subscription, MAX_WAITING as c_int) };
        Ok(())
    }

    pub fn receive(&mut self, timeout: Duration) -> Result<Option<Packet>, String> {
        let start = Instant::now();
        loop {
            if let Some(packet) = self.state.queue.pop_front() {
                return Ok(Some(packet));
            }
            if !self.is_connected() {
                return Err("the connection is gone".to_owned());
            }
            let left = timeout.saturating_sub(start.elapsed());
            let milliseconds = c_int::try_from(left.as_millis()).unwrap_or(c_int::MAX);
            // SAFETY: `lcm` lives until our Drop, and its descriptor is one that `select` takes;
            // callbacks run inside this call, while we hold the state exclusively through
            // `&mut self`.
            let status = unsafe { ffi::lcm_handle_timeout(self.lcm, milliseconds) };
            if status < 0 {
                return Err("the connection has ended".to_owned());
            }
            if status == 0 && self.state.queue.is_empty() {
                return Ok(None);
            }
        }
    }

    /// Packets that were received, pushed out, too large, and refused.
    pub fn counts(&self) -> [u64; 4] {
        let state = &self.state;
        [state.received, state.pushed_out, state.oversized, state.refused]
    }

    /// From now on no call waits longer than this for the connection's peer to take bytes, or to send the rest of a
    /// message: a call that waited so long fails. To be called again where liblcm has connected anew.
    pub fn limit_waits(&self, longest: Duration) -> io::Result<()> {
        // SAFETY: `lcm` lives until our Drop.
        let descriptor = unsafe { ffi::lcm_get_fileno(self.lcm) };
        if descriptor < 0 {
            return Err(io::ErrorKind::NotConnected.into());
        }
        // SAFETY: the descriptor is none of those that mean an error. liblcm closes it only inside calls with `lcm`,
        // and none runs meanwhile: a Handle is owned by one thread at a time, and no call outlives its own.
        let socket = unsafe { BorrowedFd::borrow_raw(descriptor) };
        let socket = SockRef::from(&socket);
        socket.set_write_timeout(Some(longest))?;
        socket.set_read_timeout(Some(longest))
    }

    /// Whether there is a descriptor that liblcm can wait for: it has none where nobody listens,
    /// or where its peer has vanished, and waiting then aborts the program.
    pub fn is_connected(&self) -> bool {
        // SAFETY: `lcm` lives until our Drop.
        (0..SELECT_LIMIT).contains(&unsafe { ffi::lcm_get_fileno(self.lcm) })
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        // SAFETY: `lcm` came from lcm_create and is destroyed once.
        unsafe { ffi::lcm_destroy(self.lcm) };
    }
}

impl State {
    /// Takes what is wanted and not too large.
    ///
    /// # Safety
    /// Where `length` fits an isize and `data` is not null, `length` bytes lie at `data`.
    unsafe fn take(
        &mut self,
        channel: &CStr,
        data: *const c_void,
        length: u32,
        received_utime: i64,
    ) {
        let Ok(channel) = channel.to_str() else {
            self.refused += 1;
            return;
        };
        let Some(limit) = self.wanted.limit_of(channel) else { return };
        let length = length as usize;
        if length > limit || isize::try_from(length).is_err() {
            self.oversized += 1;
            return;
        }
        let bytes = if length == 0 {
            Vec::new()
        } else if data.is_null() {
            self.refused += 1;
            return;
        } else {
            // SAFETY: `data` is not null and `length` fits an isize, so our caller's word holds.
            unsafe { std::slice::from_raw_parts(data.cast::<u8>(), length) }.to_vec()
        };
        if self.queue.len() >= MAX_WAITING {
            self.queue.pop_front();
            self.pushed_out += 1;
        }
        self.received += 1;
        let channel = channel.to_owned();
        self.queue.push_back(Packet { channel, bytes, received_utime, sender: None });
    }
}

unsafe extern "C" fn receive(
    buffer: *const ffi::lcm_recv_buf_t,
    channel: *const c_char,
    user: *mut c_void,
) {
    // SAFETY: liblcm passes a valid `lcm_recv_buf_t` and a NUL-terminated channel; `user` is the
    // state of the Handle inside whose `receive` we are. `memq`, `file` and `tcpq` have allocated
    // and filled `data_size` bytes at `data` before they call us. `udpm`, which computes a length
    // near 2^32 for a datagram shorter than its header, is never asked for.
    unsafe {
        let (state, buffer) = (&mut *user.cast::<State>(), &*buffer);
        let data = buffer.data.cast::<c_void>();
        state.take(CStr::from_ptr(channel), data, buffer.data_size, buffer.recv_utime);
    }
}
