//! Files that are either whole or not there.

use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

/// What a writing closure may fail with.
pub type AnyError = Box<dyn std::error::Error + Send + Sync>;

/// Bytes gathered before each write to the system.
const BUFFER_BYTES: usize = 1 << 18;

/// Writes a file so that it has its final name only when it is complete and on the disk.
///
/// `write` fills a temporary file in the same folder, which is then synced and renamed. When
/// anything fails the temporary file is removed and a file that was there before stays.
///
/// # Errors
/// [`Error::Write`] with the closure's or the system's reason.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> std::result::Result<(), AnyError>,
) -> Result<()> {
    let fail = |source: AnyError| Error::Write { path: path.into(), source };
    // A rename would replace a device such as /dev/full or a named pipe by a plain file.
    if let Ok(found) = std::fs::metadata(path)
        && !found.is_file()
    {
        let message = "a folder or device stands there";
        return Err(Error::invalid(path, message, "give the name of a plain file"));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let mut builder = tempfile::Builder::new();
    builder.prefix(".weald-").suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // The umask narrows this as for any new file; the crate's own default is owner-only.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut temporary = builder
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .map_err(|source| fail(source.into()))?;
    let mut buffered = BufWriter::with_capacity(
        BUFFER_BYTES,
        temporary.as_file_mut().try_clone().map_err(|source| fail(source.into()))?,
    );
    write(&mut buffered).map_err(fail)?;
    let finish = || -> std::io::Result<()> {
        buffered.flush()?;
        buffered.get_ref().sync_all()
    };
    let mut finish = finish;
    finish().map_err(|source| fail(source.into()))?;
    temporary.persist(path).map_err(|error| fail(error.error.into()))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failing_writer_leaves_nothing_and_keeps_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        std::fs::write(&path, "old").unwrap();
        let error = write_atomically(&path, |file| {
            file.write_all(&[b'x'; 1 << 20])?;
            Err(std::io::Error::new(std::io::ErrorKind::StorageFull, "no space left").into())
        })
        .unwrap_err();
        assert!(error.to_string().contains("table.csv") && error.to_string().contains("no space"));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn a_missing_folder_is_an_error_that_names_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no/such/folder/file");
        let error = write_atomically(&path, |_| Ok(())).unwrap_err();
        assert!(error.to_string().contains("no/such/folder/file"));
    }

    #[cfg(unix)]
    #[test]
    fn a_device_is_refused_rather_than_replaced() {
        assert!(write_atomically(Path::new("/dev/full"), |_| Ok(())).is_err());
        assert!(std::fs::metadata("/dev/full").is_ok_and(|found| !found.is_file()));
    }

    #[cfg(unix)]
    #[test]
    fn a_full_disk_is_reported_by_the_failing_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("picture.exr");
        let result = write_atomically(&path, |_| {
            let mut full = File::options().write(true).open("/dev/full")?;
            full.write_all(b"some bytes")?;
            Ok(())
        });
        assert!(matches!(result, Err(Error::Write { .. })));
        assert!(!path.exists());
    }
}
