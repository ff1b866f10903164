//! The skill itself: a store, a demonstration that runs, recognition and prediction.

use crate::answers::{linkage_prediction, linkage_recognition};
use crate::boundary::{Failure, call, free, given, linkage_result, optional_text, place, text};
use crate::frame::{linkage_frame, taken};
use linkage_planner_bridge::{PlanError, Request, Rig, predict};
use linkage_skill::internals::check_name;
use linkage_skill::object::Provenance;
use linkage_skill::predict::{PredictError, Target};
use linkage_skill::recognise::{KnownObject, Scene};
use linkage_skill::remember::{CombineError, add_demonstration};
use linkage_skill::store::{Library, Store, StoreError};
use linkage_skill::{LearnError, Learner, SkillConfig};
use nalgebra::Point3;
use std::ffi::{CString, c_char};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The skill: what is known, and what is being demonstrated.
#[allow(non_camel_case_types)]
pub struct linkage_session {
    inner: Mutex<Skill>,
}

struct Skill {
    config: SkillConfig,
    rig: Rig,
    path: PathBuf,
    library: Library,
    demonstration: Option<(String, Learner)>,
}

impl linkage_session {
    fn lock(&self) -> MutexGuard<'_, Skill> {
        // After a fault inside, the store is whole; a demonstration that ran may be lost.
        self.inner.lock().unwrap_or_else(|poisoned| {
            let mut skill = PoisonError::into_inner(poisoned);
            skill.demonstration = None;
            skill
        })
    }
}

fn stored(error: StoreError) -> Failure {
    Failure::bad(error)
}

impl From<StoreError> for Failure {
    fn from(error: StoreError) -> Self {
        stored(error)
    }
}

impl Skill {
    fn open(store: &str, profile: &str, rig: Option<&str>) -> Result<Self, Failure> {
        let path = PathBuf::from(store);
        let library = Store::open_or_create(&path).and_then(|s| s.load()).map_err(stored)?;
        let rig = rig.map_or_else(|| Ok(Rig::default()), |file| Rig::read(Path::new(file)));
        Ok(Self {
            config: SkillConfig::load(profile, None).map_err(Failure::bad)?,
            rig: rig.map_err(Failure::bad)?,
            path,
            library,
            demonstration: None,
        })
    }

    fn known(&self, object: &str) -> Result<Arc<KnownObject>, Failure> {
        let number = self
            .library
            .number(object)
            .ok_or_else(|| Failure::bad(format!("no object \"{object}\" is known")))?;
        self.library.object(number).map_err(stored)
    }

    fn feed(&mut self, frame: &linkage_driver::RgbdFrame) -> Result<(), Failure> {
        let (object, learner) = self.demonstration.as_mut().ok_or_else(no_demonstration)?;
        learner.push(frame).map_err(|e| learning(object, e))
    }

    fn finish(&mut self) -> Result<(), Failure> {
        let (object, learner) = self.demonstration.take().ok_or_else(no_demonstration)?;
        let demonstration = learner.finish(&object).map_err(|e| learning(&object, e))?;
        if demonstration.model.joints.is_empty() {
            let why = format!("{object}: {}", demonstration.why_nothing());
            return Err(Failure::no_answer(why));
        }
        let provenance = Provenance {
            source: "fed through the C interface".to_owned(),
            learned_utime: linkage_driver::live::host_utime(),
        };
        let mut store = Store::open_or_create(&self.path).map_err(stored)?;
        store.update(&object, |known| {
            add_demonstration(known, &demonstration, provenance.clone(), &self.config).map_err(
                |e| match &e {
                    CombineError::Vision(_) => Failure::internal(e),
                    _ => Failure::bad(e),
                },
            )
        })?;
        self.library = store.load().map_err(stored)?;
        Ok(())
    }

    fn recognise(&self, frame: &linkage_driver::RgbdFrame) -> Result<linkage_recognition, Failure> {
        let scene = Scene::new(frame).map_err(Failure::internal)?;
        let found = self
            .library
            .recognise(&scene, &self.config.recognise, self.config.seed)
            .map_err(stored)?;
        Ok(linkage_recognition::new(found))
    }
}

fn no_demonstration() -> Failure {
    Failure::bad("no demonstration runs; call linkage_start_demonstration first")
}

fn learning(object: &str, error: LearnError) -> Failure {
    let result = match &error {
        LearnError::TooShort { .. } | LearnError::NoDepth => linkage_result::NoAnswer,
        LearnError::Vision(_) => linkage_result::Internal,
        _ => linkage_result::BadInput,
    };
    Failure::new(result, format!("{object}: {error}"))
}

/// Opens a store, or makes an empty one. `profile` is NULL for the default; `rig` is a file with
/// motion limits, or NULL for the default ones.
///
/// # Safety
/// The texts are NULL or NUL-terminated; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_open(
    store: *const c_char,
    profile: *const c_char,
    rig: *const c_char,
    out: *mut *mut linkage_session,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (out, store, profile, rig) = unsafe {
            (
                place(out, "out")?,
                text(store, "store")?,
                optional_text(profile, "profile")?,
                optional_text(rig, "rig")?,
            )
        };
        *out = std::ptr::null_mut();
        let skill = Skill::open(store, profile.unwrap_or("default"), rig)?;
        *out = Box::into_raw(Box::new(linkage_session { inner: Mutex::new(skill) }));
        Ok(())
    })
}

/// Closes a skill; a demonstration that runs is dropped. NULL is left alone.
///
/// # Safety
/// `session` is NULL, or came from linkage_open and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_close(session: *mut linkage_session) {
    // SAFETY: the caller promises it.
    unsafe { free(session) }
}

/// Number of objects that are known; 0 for NULL.
///
/// # Safety
/// `session` is NULL, or came from linkage_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_object_count(session: *const linkage_session) -> usize {
    let mut count = 0;
    call(|| {
        // SAFETY: the caller promises it.
        count = unsafe { given(session, "session") }?.lock().library.len();
        Ok(())
    });
    count
}

/// An object's model as JSON (linkage.model/1); free it with linkage_free_text.
///
/// # Safety
/// `session` came from linkage_open; `object` is NUL-terminated; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_model_json(
    session: *const linkage_session,
    object: *const c_char,
    out: *mut *mut c_char,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (session, object, out) =
            unsafe { (given(session, "session")?, text(object, "object")?, place(out, "out")?) };
        *out = std::ptr::null_mut();
        let known = session.lock().known(object)?;
        let json = serde_json::to_string(&known.model).map_err(Failure::internal)?;
        *out = CString::new(json).map_err(Failure::internal)?.into_raw();
        Ok(())
    })
}

/// Frees what linkage_model_json gave. NULL is left alone.
///
/// # Safety
/// `text` is NULL, or came from linkage_model_json and is not used any more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_free_text(text: *mut c_char) {
    if !text.is_null() {
        // SAFETY: it came from `CString::into_raw`, as the caller promises.
        drop(unsafe { CString::from_raw(text) });
    }
}

/// Begins to watch how a person moves an object. One that is known already gets another
/// demonstration.
///
/// # Safety
/// `session` came from linkage_open; `object` is NUL-terminated.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_start_demonstration(
    session: *mut linkage_session,
    object: *const c_char,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (session, object) = unsafe { (given(session, "session")?, text(object, "object")?) };
        let mut skill = session.lock();
        check_name(object).map_err(|reason| Failure::bad(format!("object: {reason}")))?;
        if let Some((running, _)) = &skill.demonstration {
            let why = format!("{running} is being demonstrated; finish or cancel that first");
            return Err(Failure::bad(why));
        }
        skill.demonstration = Some((object.to_owned(), Learner::new(&skill.config)));
        Ok(())
    })
}

/// Gives the next frame of the demonstration.
///
/// # Safety
/// `session` came from linkage_open; the frame's buffers hold what it says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_feed(
    session: *mut linkage_session,
    frame: *const linkage_frame,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (session, frame) = unsafe { (given(session, "session")?, taken(frame)?) };
        session.lock().feed(&frame)
    })
}

/// Learns from the demonstration and stores the object. LINKAGE_RESULT_NO_ANSWER when nothing
/// articulated was moved. The demonstration is over either way.
///
/// # Safety
/// `session` came from linkage_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_finish_demonstration(
    session: *mut linkage_session,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        unsafe { given(session, "session") }?.lock().finish()
    })
}

/// Drops the demonstration that runs, if any.
///
/// # Safety
/// `session` came from linkage_open.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_cancel_demonstration(
    session: *mut linkage_session,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        unsafe { given(session, "session") }?.lock().demonstration = None;
        Ok(())
    })
}

/// Looks for all that is known in one frame. An answer without matches is LINKAGE_RESULT_OK.
///
/// # Safety
/// `session` came from linkage_open; the frame's buffers hold what it says; `out` is valid for a
/// write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_recognise(
    session: *mut linkage_session,
    frame: *const linkage_frame,
    out: *mut *mut linkage_recognition,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (session, out) = unsafe { (given(session, "session")?, place(out, "out")?) };
        *out = std::ptr::null_mut();
        // SAFETY: the caller promises it.
        let frame = unsafe { taken(frame) }?;
        *out = Box::into_raw(Box::new(session.lock().recognise(&frame)?));
        Ok(())
    })
}

/// What is to be predicted.
#[allow(non_camel_case_types)]
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct linkage_request {
    /// The joint to move; NULL or empty for all that were seen.
    pub joint: *const c_char,
    /// open, closed, or a configuration in radians or metres.
    pub target: *const c_char,
    /// A target outside the range that was seen is allowed, by at most a turn or a metre.
    pub outside_range: bool,
    /// `grasp` is given; else handles are where the demonstrator's hand was.
    pub has_grasp: bool,
    /// What the gripper holds now: a point in the camera frame, metres.
    pub grasp: [f64; 3],
}

/// Plans the motion of a recognised object. LINKAGE_RESULT_NO_ANSWER when the joint's present
/// configuration was not seen.
///
/// # Safety
/// `session` came from linkage_open, `recognition` from linkage_recognise; the request's texts are
/// NULL or NUL-terminated; `out` is valid for a write.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn linkage_predict(
    session: *const linkage_session,
    recognition: *const linkage_recognition,
    match_index: usize,
    request: *const linkage_request,
    out: *mut *mut linkage_prediction,
) -> linkage_result {
    call(|| {
        // SAFETY: the caller promises it.
        let (session, recognition, request, out) = unsafe {
            (
                given(session, "session")?,
                given(recognition, "recognition")?,
                given(request, "request")?,
                place(out, "out")?,
            )
        };
        *out = std::ptr::null_mut();
        // SAFETY: the caller promises it.
        let (joint, target) = unsafe {
            (optional_text(request.joint, "joint")?, optional_text(request.target, "target")?)
        };
        let target: Target = target.unwrap_or("open").parse().map_err(Failure::bad)?;
        let target = match target {
            Target::Value(q) if request.outside_range => Target::Unseen(q),
            within => within,
        };
        if request.has_grasp && !request.grasp.iter().all(|x| x.is_finite()) {
            return Err(Failure::bad("the grasp is not finite"));
        }
        let grasp = request.has_grasp.then(|| Point3::from(request.grasp));
        let found = recognition.found(match_index)?;
        let skill = session.lock();
        let known = skill.known(&found.object)?;
        let request = Request { joint, target, grasp, moving: None };
        let plan = predict(&known.model, found, &request, &skill.rig).map_err(|e| match &e {
            PlanError::Predict(PredictError::Unseen { .. }) => Failure::no_answer(e),
            _ => Failure::bad(e),
        })?;
        *out = Box::into_raw(Box::new(linkage_prediction::new(plan.prediction)));
        Ok(())
    })
}
