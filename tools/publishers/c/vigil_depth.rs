//! Depth frames from C: `vigil_depth.h` says what each function does.

use anyhow::{Context, Result, anyhow, bail};
use std::cell::RefCell;
use std::ffi::{CStr, CString, c_char, c_int};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;
use std::ptr;
use vigil_io::clock::monotonic_ns;
use vigil_io::key_file::frame_key;
use vigil_io::shared_memory::{DEPTH_TOPIC, Domain, FramePublisher, is_timely};
use vigil_sensors::{Counts, Mount, Pinhole, Projector, Resolution};
use vigil_types::{Attitude, DEPTH_FULL_SCALE_M, DEPTH_PIXELS, FrameKey, FrdVector, Nanos, NedVector};

/// The highest instance.
const LAST_INSTANCE: u32 = 99;
/// What is less is 0 as a pixel.
const LEAST_M: f32 = 1e-30;
/// No depth sensor measures farther: what is, is of another unit.
const FARTHEST_M: f32 = 1000.0;
/// An estimate farther from the origin is none.
const FARTHEST_PLACE_M: f32 = 100_000.0;

thread_local! {
    static ERROR: RefCell<CString> = RefCell::default();
}

/// The one source of frames of an instance.
pub struct Publisher {
    publisher: FramePublisher,
    key: Option<FrameKey>,
    sensor_id: u32,
    sequence: u64,
    last_stamp_ns: Option<Nanos>,
}

impl Publisher {
    fn open(instance: u32, sensor_id: u32, key_file: Option<&CStr>) -> Result<Self> {
        if instance > LAST_INSTANCE {
            bail!("instance {instance}: must be from 0 to {LAST_INSTANCE}");
        }
        let key = |path: &CStr| {
            let path = path.to_str().context("the key file's name is not UTF-8")?;
            anyhow::Ok(frame_key(Path::new(path), sensor_id)?)
        };
        let key = key_file.map(key).transpose()?;
        let domain = Domain::open(instance, "driver")?;
        Ok(Self {
            publisher: FramePublisher::create(&domain, DEPTH_TOPIC)?,
            key,
            sensor_id,
            sequence: 0,
            last_stamp_ns: None,
        })
    }

    fn publish(&mut self, ranges_m: &[f32], position: [f32; 3], attitude: [f32; 4], stamp_ns: Nanos) -> Result<usize> {
        let [north, east, down] = position;
        let [w, x, y, z] = attitude;
        let (position_ned_m, attitude) = (NedVector::new(north, east, down), Attitude { w, x, y, z });
        let is_near = |m: &f32| m.abs() <= FARTHEST_PLACE_M;
        if !position.iter().all(is_near) || !attitude.is_valid() {
            bail!("position_ned_m must be finite, within 100 km, and attitude_wxyz of unit length");
        }
        check_ranges(ranges_m)?;
        let now_ns = monotonic_ns();
        if !is_timely(stamp_ns, now_ns) {
            bail!(
                "stamp_ns {stamp_ns} is not of the last second of CLOCK_MONOTONIC ({now_ns} now): stamp with vigil_depth_now_ns, at \
                 capture"
            );
        }
        if self.last_stamp_ns.is_some_and(|last_ns| stamp_ns <= last_ns) {
            bail!("stamp_ns {stamp_ns} is not newer than that of the frame before");
        }
        let readers = self.publisher.publish_with(|frame| {
            for (pixel, range_m) in frame.depth.iter_mut().zip(ranges_m) {
                *pixel = if is_return(*range_m) {
                    range_m / DEPTH_FULL_SCALE_M
                } else {
                    1.0
                };
            }
            let header = &mut frame.header;
            (header.stamp_ns, header.sequence, header.sensor_id) = (stamp_ns, self.sequence, self.sensor_id);
            (header.position_ned_m, header.attitude) = (position_ned_m, attitude);
            match &self.key {
                Some(key) => frame.authenticate(key),
                None => frame.seal(),
            }
        })?;
        (self.sequence, self.last_stamp_ns) = (self.sequence + 1, Some(stamp_ns));
        Ok(readers)
    }
}

fn is_return(range_m: f32) -> bool {
    range_m > LEAST_M && range_m < DEPTH_FULL_SCALE_M
}

/// Refuses lengths of another unit than metres.
fn check_unit(mut lengths_m: impl Iterator<Item = f32>, no_return: &str) -> Result<()> {
    match lengths_m.find(|m| m.is_finite() && *m > FARTHEST_M) {
        Some(length_m) => bail!(
            "a length of {length_m}: metres are needed (of millimetres, divide by 1000), and {no_return} where nothing returned"
        ),
        None => Ok(()),
    }
}

/// Refuses an image that must not be published: no return reads as free space, so one in which nothing returned, or of another
/// unit, would clear the way.
fn check_ranges(ranges_m: &[f32]) -> Result<()> {
    check_unit(ranges_m.iter().copied(), "infinity")?;
    if ranges_m.iter().any(|range_m| is_return(*range_m)) {
        return Ok(());
    }
    let count = |is: fn(f32) -> bool| ranges_m.iter().filter(|range_m| is(**range_m)).count();
    bail!(
        "an image without a single range: {} pixels are not finite, {} are 0 or less, {} are 100 m or farther. Nothing was \
         published, for it would read as free space: is the sensor covered, is the unit metres?",
        count(|m| !m.is_finite()),
        count(|m| m.is_finite() && m <= LEAST_M),
        count(|m| m.is_finite() && m > LEAST_M)
    )
}

/// Runs `work`; what went wrong is kept for [`vigil_depth_error`]. A panic does not cross into C.
fn kept<T>(work: impl FnOnce() -> Result<T>) -> Option<T> {
    let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| Err(anyhow!("a defect of this library")));
    match outcome {
        Ok(value) => Some(value),
        Err(error) => {
            // Each error's text says its cause.
            let text = error.to_string().replace('\0', " ");
            ERROR.with_borrow_mut(|kept| *kept = CString::new(text).unwrap_or_default());
            None
        }
    }
}

/// # Safety
/// `key_file` is null or a string that ends with a zero.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vigil_depth_open(instance: u32, sensor_id: u32, key_file: *const c_char) -> *mut Publisher {
    // SAFETY: as the caller promises.
    let key_file = (!key_file.is_null()).then(|| unsafe { CStr::from_ptr(key_file) });
    let publisher = kept(|| Publisher::open(instance, sensor_id, key_file));
    publisher.map_or(ptr::null_mut(), |publisher| Box::into_raw(Box::new(publisher)))
}

/// # Safety
/// `publisher` is null or of [`vigil_depth_open`] in this thread and not closed; the arrays are null or as long as the header says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vigil_depth_publish(
    publisher: *mut Publisher,
    ranges_m: *const f32,
    position_ned_m: *const f32,
    attitude_wxyz: *const f32,
    stamp_ns: u64,
) -> c_int {
    let published = kept(|| {
        if ranges_m.is_null() || position_ned_m.is_null() || attitude_wxyz.is_null() {
            bail!("ranges_m, position_ned_m or attitude_wxyz is NULL");
        }
        // SAFETY: as the caller promises.
        let publisher = unsafe { publisher.as_mut() }.context("the publisher is NULL")?;
        // SAFETY: not null, and as long as the header says.
        let (ranges_m, position, attitude) = unsafe {
            (
                std::slice::from_raw_parts(ranges_m, DEPTH_PIXELS),
                ptr::read_unaligned(position_ned_m.cast::<[f32; 3]>()),
                ptr::read_unaligned(attitude_wxyz.cast::<[f32; 4]>()),
            )
        };
        publisher.publish(ranges_m, position, attitude, stamp_ns)
    });
    published.map_or(-1, |readers| c_int::try_from(readers).unwrap_or(c_int::MAX))
}

fn mount_of([x, y, z, roll, pitch, yaw]: [f32; 6]) -> Result<Mount> {
    let turn = Attitude::from_euler_rad(roll, pitch, yaw);
    Ok(Mount::new(FrdVector::new(x, y, z), turn)?)
}

/// The ranges of an image that `add` gives to a projector.
fn project(
    resolution: Resolution,
    ranges_m: &mut [f32; DEPTH_PIXELS],
    add: impl FnOnce(&mut Projector) -> Result<Counts>,
) -> Result<usize> {
    let mut projector = Projector::new(resolution);
    let counts = add(&mut projector)?;
    // What lies out of view was measured, and so was what is too near: then nothing in view is an answer.
    if counts.used + counts.out_of_view + counts.too_near == 0 {
        bail!(
            "not one of {} points or pixels is a measurement: {} without a return or 100 m away and farther, {} not finite or \
             negative. That is no free space: is the sensor covered, is the unit metres?",
            counts.total(),
            counts.no_return,
            counts.impossible
        );
    }
    let returned = projector.finish(ranges_m);
    for range in ranges_m.iter_mut() {
        *range = if *range < 1.0 {
            *range * DEPTH_FULL_SCALE_M
        } else {
            f32::INFINITY
        };
    }
    Ok(returned)
}

fn count(returned: Option<usize>) -> c_int {
    returned.and_then(|n| c_int::try_from(n).ok()).unwrap_or(-1)
}

/// # Safety
/// The arrays are null or as long as the header says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vigil_depth_project_points(
    points_frd_m: *const f32,
    points: usize,
    mount: *const f32,
    across_deg: f32,
    down_deg: f32,
    ranges_m: *mut f32,
) -> c_int {
    count(kept(|| {
        if points_frd_m.is_null() || mount.is_null() || ranges_m.is_null() {
            bail!("points_frd_m, mount or ranges_m is NULL");
        }
        // SAFETY: not null, and as long as the header says.
        let (given, mount, ranges_m) = unsafe {
            (
                std::slice::from_raw_parts(points_frd_m.cast::<[f32; 3]>(), points),
                ptr::read_unaligned(mount.cast::<[f32; 6]>()),
                &mut *ranges_m.cast::<[f32; DEPTH_PIXELS]>(),
            )
        };
        let mount = mount_of(mount)?;
        check_unit(given.iter().flatten().map(|m| m.abs()), "0, 0, 0")?;
        project(Resolution::of_degrees(across_deg, down_deg)?, ranges_m, |projector| {
            Ok(projector.add_points(&mount, given.iter().map(|[x, y, z]| FrdVector::new(*x, *y, *z))))
        })
    }))
}

/// # Safety
/// The arrays are null or as long as the header says.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vigil_depth_project_image(
    depth: *const u16,
    width: u32,
    height: u32,
    intrinsics: *const f32,
    metres_per_unit: f32,
    mount: *const f32,
    ranges_m: *mut f32,
) -> c_int {
    count(kept(|| {
        if depth.is_null() || intrinsics.is_null() || mount.is_null() || ranges_m.is_null() {
            bail!("depth, intrinsics, mount or ranges_m is NULL");
        }
        // SAFETY: not null, and as long as the header says.
        let ([fx, fy, cx, cy], mount) = unsafe {
            (
                ptr::read_unaligned(intrinsics.cast::<[f32; 4]>()),
                ptr::read_unaligned(mount.cast::<[f32; 6]>()),
            )
        };
        let size = [width as usize, height as usize];
        let camera = Pinhole::new(size, [fx, fy], [cx, cy])?;
        let mount = mount_of(mount)?;
        // SAFETY: not null, and as long as the header says; a camera's size was checked.
        let (units, ranges_m) = unsafe {
            (
                std::slice::from_raw_parts(depth, size[0] * size[1]),
                &mut *ranges_m.cast::<[f32; DEPTH_PIXELS]>(),
            )
        };
        project(camera.resolution()?, ranges_m, |projector| {
            Ok(projector.add_depth_units(&mount, &camera, units, metres_per_unit)?)
        })
    }))
}

/// The time of `CLOCK_MONOTONIC`, nanoseconds.
#[unsafe(no_mangle)]
pub extern "C" fn vigil_depth_now_ns() -> u64 {
    monotonic_ns()
}

/// What went wrong last in this thread.
#[unsafe(no_mangle)]
pub extern "C" fn vigil_depth_error() -> *const c_char {
    ERROR.with_borrow(|kept| kept.as_ptr())
}

/// # Safety
/// `publisher` is null or of [`vigil_depth_open`] in this thread and not closed before.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn vigil_depth_close(publisher: *mut Publisher) {
    if !publisher.is_null() {
        // SAFETY: as the caller promises; it was made by `Box::into_raw`.
        drop(unsafe { Box::from_raw(publisher) });
    }
}
