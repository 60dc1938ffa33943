//! Embree's C interface, as far as two-level scenes of triangles need it, loaded at run time.

use super::wood::Wood;
use crate::thread_time;
use std::error::Error;
use std::ffi::{CString, c_char, c_int, c_uint, c_void};
use std::time::Duration;
use weald_render::probe::Probe;

/// How much work a build may take.
#[derive(Clone, Copy)]
pub enum Quality {
    Medium = 1,
    High = 2,
}

type Handle = *mut c_void;

/// A ray and its hit, as Embree lays them out for one level of instancing.
#[repr(C, align(16))]
#[derive(Clone, Copy)]
struct RayHit {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: u32,
    id: u32,
    flags: u32,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: u32,
    geometry: u32,
    instance: u32,
    place: u32,
}

impl RayHit {
    fn new(probe: &Probe) -> Self {
        Self {
            origin: probe.origin,
            near: 0.0,
            direction: probe.direction,
            time: 0.0,
            far: f32::INFINITY,
            mask: u32::MAX,
            id: 0,
            flags: 0,
            normal: [0.0; 3],
            uv: [0.0; 2],
            primitive: u32::MAX,
            geometry: u32::MAX,
            instance: u32::MAX,
            place: u32::MAX,
        }
    }
}

type Trace = unsafe extern "C" fn(Handle, *mut RayHit, *const c_void);

/// A scene in Embree.
pub struct Embree {
    scene: Handle,
    intersect: Trace,
    occluded: Trace,
}

struct Library(Handle);

impl Library {
    fn open(path: &str) -> Result<Self, Box<dyn Error>> {
        unsafe extern "C" {
            fn dlopen(path: *const c_char, flags: c_int) -> Handle;
        }
        let name = CString::new(path)?;
        // SAFETY: a path that ends with zero; 2 binds all symbols at once.
        let handle = unsafe { dlopen(name.as_ptr(), 2) };
        if handle.is_null() {
            Err(format!("{path} cannot be loaded").into())
        } else {
            Ok(Self(handle))
        }
    }

    /// A function of the library.
    ///
    /// # Safety
    /// `F` is the function's type.
    unsafe fn get<F: Copy>(&self, name: &str) -> Result<F, Box<dyn Error>> {
        unsafe extern "C" {
            fn dlsym(library: Handle, name: *const c_char) -> Handle;
        }
        let text = CString::new(name)?;
        // SAFETY: the library is open, the name ends with zero.
        let address = unsafe { dlsym(self.0, text.as_ptr()) };
        if address.is_null() {
            return Err(format!("the library has no {name}").into());
        }
        // SAFETY: the caller vouches for the type; functions are as large as pointers.
        Ok(unsafe { std::mem::transmute_copy(&address) })
    }
}

/// Numbers of Embree's enumerations.
const TRIANGLES: c_int = 0;
const INSTANCE_ARRAY: c_int = 122;
const INDICES: c_int = 0;
const VERTICES: c_int = 1;
const TRANSFORMS: c_int = 23;
const UINT3: c_int = 0x5003;
const FLOAT3: c_int = 0x9003;
const ROWS_3X4: c_int = 0x9134;

impl Embree {
    /// The tree as one scene, placed in another beside the ground.
    pub fn new(path: &str, wood: &Wood, quality: Quality) -> Result<Self, Box<dyn Error>> {
        let library = Library::open(path)?;
        // SAFETY: the types are those of Embree 4's header.
        unsafe {
            let new_device: unsafe extern "C" fn(*const c_char) -> Handle =
                library.get("rtcNewDevice")?;
            let new_scene: unsafe extern "C" fn(Handle) -> Handle = library.get("rtcNewScene")?;
            let set_quality: unsafe extern "C" fn(Handle, c_int) =
                library.get("rtcSetSceneBuildQuality")?;
            let new_geometry: unsafe extern "C" fn(Handle, c_int) -> Handle =
                library.get("rtcNewGeometry")?;
            let new_buffer: unsafe extern "C" fn(
                Handle,
                c_int,
                c_uint,
                c_int,
                usize,
                usize,
            ) -> *mut c_void = library.get("rtcSetNewGeometryBuffer")?;
            let commit_geometry: unsafe extern "C" fn(Handle) = library.get("rtcCommitGeometry")?;
            let attach: unsafe extern "C" fn(Handle, Handle) -> c_uint =
                library.get("rtcAttachGeometry")?;
            let commit: unsafe extern "C" fn(Handle) = library.get("rtcCommitScene")?;
            let set_instanced: unsafe extern "C" fn(Handle, Handle) =
                library.get("rtcSetGeometryInstancedScene")?;

            let device = new_device(c"threads=2".as_ptr());
            let mesh = |positions: &[[f32; 3]], triangles: &[[u32; 3]]| {
                let geometry = new_geometry(device, TRIANGLES);
                let vertices = new_buffer(geometry, VERTICES, 0, FLOAT3, 12, positions.len());
                vertices.cast::<[f32; 3]>().copy_from(positions.as_ptr(), positions.len());
                let indices = new_buffer(geometry, INDICES, 0, UINT3, 12, triangles.len());
                indices.cast::<[u32; 3]>().copy_from(triangles.as_ptr(), triangles.len());
                commit_geometry(geometry);
                geometry
            };
            let (positions, triangles) = wood.soup();
            let tree = new_scene(device);
            set_quality(tree, quality as c_int);
            attach(tree, mesh(&positions, &triangles));
            commit(tree);
            let scene = new_scene(device);
            set_quality(scene, quality as c_int);
            attach(scene, mesh(&wood.ground.positions, &wood.ground.triangles));
            let places = new_geometry(device, INSTANCE_ARRAY);
            set_instanced(places, tree);
            let matrices = new_buffer(places, TRANSFORMS, 0, ROWS_3X4, 48, wood.places.len())
                .cast::<[f32; 12]>();
            for (index, place) in wood.places.iter().enumerate() {
                matrices.add(index).write(Wood::matrix(place));
            }
            commit_geometry(places);
            attach(scene, places);
            commit(scene);
            Ok(Self {
                scene,
                intersect: library.get("rtcIntersect1")?,
                occluded: library.get("rtcOccluded1")?,
            })
        }
    }

    /// Time and distances; of shadow rays 0 where something is in the way.
    pub fn trace(&self, probes: &[Probe], is_shadow: bool) -> (Duration, Vec<f32>) {
        let function = if is_shadow { self.occluded } else { self.intersect };
        let saved = flush_denormals(None);
        let start = thread_time();
        let one = |probe: &Probe| {
            let mut ray = RayHit::new(probe);
            // SAFETY: the scene is committed; no arguments means defaults.
            unsafe { function(self.scene, &mut ray, std::ptr::null()) };
            if is_shadow && ray.far < 0.0 { 0.0 } else { ray.far }
        };
        let found = probes.iter().map(one).collect();
        let time = thread_time() - start;
        flush_denormals(Some(saved));
        (time, found)
    }
}

/// Lets the processor take denormal numbers for 0, as Embree's manual recommends, or puts a saved
/// state back; returns the state before.
fn flush_denormals(state: Option<u32>) -> u32 {
    let mut before = 0u32;
    #[cfg(target_arch = "x86_64")]
    // SAFETY: reads and writes the rounding state of this thread only.
    unsafe {
        std::arch::asm!("stmxcsr [{}]", in(reg) &mut before);
        let next = state.unwrap_or(before | 0x8040);
        std::arch::asm!("ldmxcsr [{}]", in(reg) &next);
    }
    before
}
