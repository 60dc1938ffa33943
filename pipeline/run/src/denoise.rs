//! Taking the noise out of a picture by Open Image Denoise, a library that is loaded when asked for.
//!
//! It is not part of the program: it is large, and a picture without it is complete. It sees the
//! light of all samples beside albedo and normals, and what it makes of them becomes `R G B`; what
//! was there before stays in the picture as `noisy.R`, `noisy.G` and `noisy.B`.

use crate::error::{Error, Result};
use libloading::Library;
use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr;
use weald_contract::Picture;

/// Environment variable that names the library's file.
const VARIABLE: &str = "WEALD_OIDN";

/// Names under which systems know the library.
const NAMES: [&str; 4] = [
    "libOpenImageDenoise.so.2",
    "libOpenImageDenoise.so",
    "libOpenImageDenoise.2.dylib",
    "OpenImageDenoise.dll",
];

/// A device, a filter.
type Handle = *mut c_void;
type Make = unsafe extern "C" fn(c_int) -> Handle;
type MakeFilter = unsafe extern "C" fn(Handle, *const c_char) -> Handle;
type Act = unsafe extern "C" fn(Handle);
type SetBool = unsafe extern "C" fn(Handle, *const c_char, bool);
type SetImage = unsafe extern "C" fn(
    Handle,
    *const c_char,
    *mut c_void,
    c_int,
    usize,
    usize,
    usize,
    usize,
    usize,
);
type GetError = unsafe extern "C" fn(Handle, *mut *const c_char) -> c_int;

/// Numbers of the library's enumerations.
const PROCESSOR: c_int = 1;
const FLOAT3: c_int = 3;

/// Open Image Denoise 2.
pub struct Denoiser {
    // Functions before the library that they live in: fields are dropped in this order.
    new_device: Make,
    commit_device: Act,
    release_device: Act,
    new_filter: MakeFilter,
    set_bool: SetBool,
    set_image: SetImage,
    commit_filter: Act,
    execute_filter: Act,
    release_filter: Act,
    get_error: GetError,
    _library: Library,
}

impl Denoiser {
    /// Loads the library: the file that the environment names, or the system's.
    ///
    /// # Errors
    /// There is none, or it is not version 2.
    pub fn load() -> Result<Self> {
        let chosen = std::env::var_os(VARIABLE);
        let names = match &chosen {
            Some(path) => vec![path.clone()],
            None => NAMES.map(Into::into).to_vec(),
        };
        // SAFETY: what the library does when it is loaded is for the user to trust, who named it
        // or put it where the system looks; ours starts no code of its own.
        let opened = names.iter().find_map(|name| unsafe { Library::new(name) }.ok());
        let Some(library) = opened else {
            let message = match chosen {
                Some(path) => format!("{VARIABLE}: {} cannot be loaded", path.display()),
                None => "`denoise` needs Open Image Denoise 2, which is not installed".to_string(),
            };
            let hint = format!("install it, or let {VARIABLE} name its library, or leave it out");
            return Err(Error::plain(message, hint));
        };
        Self::of(library).map_err(|missing| {
            let message = format!("the library of Open Image Denoise has no {missing}");
            Error::plain(message, "version 2 is needed".to_string())
        })
    }

    fn of(library: Library) -> std::result::Result<Self, &'static str> {
        /// A function of the library.
        ///
        /// # Safety
        /// `F` is its type.
        unsafe fn get<F: Copy>(
            library: &Library,
            name: &'static str,
        ) -> std::result::Result<F, &'static str> {
            // SAFETY: the caller vouches for the type.
            unsafe { library.get::<F>(name.as_bytes()) }.map(|found| *found).map_err(|_| name)
        }
        // SAFETY: the types are those that the header of version 2 declares.
        unsafe {
            Ok(Self {
                new_device: get(&library, "oidnNewDevice")?,
                commit_device: get(&library, "oidnCommitDevice")?,
                release_device: get(&library, "oidnReleaseDevice")?,
                new_filter: get(&library, "oidnNewFilter")?,
                set_bool: get(&library, "oidnSetFilterBool")?,
                set_image: get(&library, "oidnSetSharedFilterImage")?,
                commit_filter: get(&library, "oidnCommitFilter")?,
                execute_filter: get(&library, "oidnExecuteFilter")?,
                release_filter: get(&library, "oidnReleaseFilter")?,
                get_error: get(&library, "oidnGetDeviceError")?,
                _library: library,
            })
        }
    }

    /// Replaces `R G B` by what is left without noise, and keeps them as `noisy.R/G/B`.
    ///
    /// # Errors
    /// The library fails, or the picture lacks light, albedo or normals.
    pub fn denoise(&self, picture: &mut Picture) -> Result<()> {
        let layer = |names: [&str; 3]| -> Result<Vec<f32>> {
            let planes: Option<Vec<&[f32]>> =
                names.iter().map(|name| picture.channel(name)).collect();
            let planes = planes.ok_or_else(|| {
                let message = format!("the picture lacks {}", names.join(", "));
                Error::plain(message, "it takes them to tell noise from detail".to_string())
            })?;
            let pixel = |i: usize| planes.iter().map(move |plane| plane[i]);
            Ok((0..picture.width * picture.height).flat_map(pixel).collect())
        };
        let mut light = layer(["R", "G", "B"])?;
        let mut albedo = layer(["albedo.R", "albedo.G", "albedo.B"])?;
        let mut normal = layer(["normal.X", "normal.Y", "normal.Z"])?;
        let mut output = vec![0.0f32; light.len()];
        let images = [
            (c"color", &mut light),
            (c"albedo", &mut albedo),
            (c"normal", &mut normal),
            (c"output", &mut output),
        ];
        self.run(images, [picture.width, picture.height])?;
        for (index, name) in ["R", "G", "B"].into_iter().enumerate() {
            let clean = output.iter().skip(index).step_by(3).map(|value| value.max(0.0)).collect();
            if let Some(channel) = picture.channels.iter_mut().find(|c| c.name == name) {
                let noisy = std::mem::replace(&mut channel.values, clean);
                picture.add(&format!("noisy.{name}"), false, noisy);
            }
        }
        Ok(())
    }

    /// Runs the filter for path-traced pictures on images of three floats a pixel.
    fn run(&self, images: [(&CStr, &mut Vec<f32>); 4], [width, height]: [usize; 2]) -> Result<()> {
        // SAFETY: the functions are called as the library's manual says; each image holds
        // 3 x width x height floats and outlives the filter, which is released last but one.
        unsafe {
            let device = (self.new_device)(PROCESSOR);
            if device.is_null() {
                return Err(self.failure(device));
            }
            (self.commit_device)(device);
            let filter = (self.new_filter)(device, c"RT".as_ptr());
            if filter.is_null() {
                let failure = self.failure(device);
                (self.release_device)(device);
                return Err(failure);
            }
            for (name, image) in images {
                debug_assert_eq!(image.len(), 3 * width * height);
                let start = image.as_mut_ptr().cast();
                (self.set_image)(filter, name.as_ptr(), start, FLOAT3, width, height, 0, 0, 0);
            }
            (self.set_bool)(filter, c"hdr".as_ptr(), true);
            (self.commit_filter)(filter);
            (self.execute_filter)(filter);
            let mut text = ptr::null();
            let is_done = (self.get_error)(device, &raw mut text) == 0;
            let failure = (!is_done).then(|| failed(text));
            (self.release_filter)(filter);
            (self.release_device)(device);
            failure.map_or(Ok(()), Err)
        }
    }

    /// What the library says went wrong.
    unsafe fn failure(&self, device: Handle) -> Error {
        let mut text = ptr::null();
        // SAFETY: a device, or none, both of which the library allows here.
        unsafe {
            (self.get_error)(device, &raw mut text);
            failed(text)
        }
    }
}

/// An error with the library's words.
///
/// # Safety
/// The text is null, or ends with zero.
unsafe fn failed(text: *const c_char) -> Error {
    let said = if text.is_null() {
        "no reason given".into()
    } else {
        // SAFETY: the caller vouches for it.
        unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned()
    };
    Error::plain(format!("Open Image Denoise failed: {said}"), "render without it".to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey picture with noise, or `None` where the library is not installed.
    #[test]
    fn noise_goes_and_the_mean_stays_where_the_library_is_installed() {
        let Ok(denoiser) = Denoiser::load() else {
            eprintln!("skipped: Open Image Denoise is not installed");
            return;
        };
        let (width, height) = (64, 48);
        let mut chance = weald_contract::Seed(1).stream("noise", 0);
        let mut picture = Picture::new(width, height);
        let noisy: Vec<f32> = (0..width * height).map(|_| 2.0 * chance.unit() as f32).collect();
        for name in ["R", "G", "B", "albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y"] {
            picture.add(name, false, if name.len() == 1 { noisy.clone() } else { vec![0.5; 3072] });
        }
        picture.add("normal.Z", false, vec![0.7; 3072]);
        denoiser.denoise(&mut picture).unwrap();
        assert_eq!(picture.channel("noisy.G"), Some(&noisy[..]));
        let clean = picture.channel("G").unwrap();
        let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
        let spread = |values: &[f32]| {
            let middle = mean(values);
            (values.iter().map(|v| (v - middle).powi(2)).sum::<f32>() / values.len() as f32).sqrt()
        };
        assert!((mean(clean) - mean(&noisy)).abs() < 0.05, "{}", mean(clean));
        assert!(spread(clean) < 0.2 * spread(&noisy), "{}", spread(clean));
    }
}
