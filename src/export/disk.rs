//! Output files onto the disk, all of them or none.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, ErrorKind, Write};
use std::path::{Component, Path, PathBuf};

use tempfile::{Builder, NamedTempFile};

use super::OutputFile;
use crate::diagnostic::{Error, Result};

/// Writes `files` into `dir`, making folders as needed. Each goes to a temporary file beside
/// its destination and is flushed to the disk; only when all are there are they renamed over
/// what was there before. On an error nothing earlier has changed, and temporary files and
/// folders made on the way are removed.
///
/// A rename that fails after others succeeded would leave a mixture; folders in the way, the
/// one foreseeable cause, are looked for first.
pub fn write_all(dir: &Path, files: &[OutputFile]) -> Result<()> {
    check_paths(files)?;
    let mut made = MadeFolders(Vec::new());
    make_folder(dir, &mut made)?;
    let mut written: Vec<(NamedTempFile, PathBuf)> = Vec::with_capacity(files.len());
    for file in files {
        let path = dir.join(&file.path);
        let parent = path.parent().unwrap_or(dir);
        make_folder(parent, &mut made)?;
        if path.is_dir() {
            return Err(Error::new("is a folder, so no file can be written there")
                .in_file(&path)
                .remedy("move it away, or choose another output folder or name"));
        }
        let temporary = write_temporary(parent, &file.bytes)
            .map_err(|e| unwritable(&path, &e, file.bytes.len()))?;
        written.push((temporary, path));
    }
    for (temporary, path) in written {
        temporary.persist(&path).map_err(|e| unwritable(&path, &e.error, 0))?;
    }
    made.0.clear();
    Ok(())
}

/// Whether [`write_all`] could write into `dir`, so that a long run need not find out at its end.
/// Leaves nothing behind.
pub fn check_writable(dir: &Path) -> Result<()> {
    let mut made = MadeFolders(Vec::new());
    make_folder(dir, &mut made)?;
    let probe = write_temporary(dir, &[]).map_err(|e| unwritable(dir, &e, 0))?;
    drop(probe);
    Ok(())
}

/// Below the output folder, and each once.
fn check_paths(files: &[OutputFile]) -> Result<()> {
    let mut seen = BTreeSet::new();
    for OutputFile { path, .. } in files {
        let below = path.components().all(|c| matches!(c, Component::Normal(_)));
        if !below || path.file_name().is_none() {
            return Err(Error::new("is not a path below the output folder")
                .in_file(path)
                .remedy("choose an output name without `..` and without a leading `/`"));
        }
        if !seen.insert(path) {
            return Err(Error::new("would be written twice")
                .in_file(path)
                .remedy("give each output a name of its own"));
        }
    }
    Ok(())
}

/// Folders that were not there before, parents first; removed again when dropped, if empty.
struct MadeFolders(Vec<PathBuf>);

impl Drop for MadeFolders {
    fn drop(&mut self) {
        for folder in self.0.iter().rev() {
            // A folder that is in use by now is not ours alone and stays.
            let _ = fs::remove_dir(folder);
        }
    }
}

fn make_folder(folder: &Path, made: &mut MadeFolders) -> Result<()> {
    let missing: Vec<&Path> =
        folder.ancestors().take_while(|f| !f.as_os_str().is_empty() && !f.exists()).collect();
    for folder in missing.into_iter().rev() {
        match fs::create_dir(folder) {
            Ok(()) => made.0.push(folder.to_path_buf()),
            Err(e) if e.kind() == ErrorKind::AlreadyExists && folder.is_dir() => {}
            Err(e) => return Err(no_folder(folder, &e)),
        }
    }
    if folder.as_os_str().is_empty() || folder.is_dir() {
        return Ok(());
    }
    Err(Error::new("is a file, not a folder")
        .in_file(folder)
        .remedy("choose another output folder, or move the file away"))
}

fn no_folder(folder: &Path, error: &io::Error) -> Error {
    if error.kind() == ErrorKind::NotADirectory {
        let file = folder.ancestors().find(|f| f.is_file()).unwrap_or(folder);
        return Error::new("is a file, so no folder can be made in it")
            .in_file(file)
            .remedy("choose another output folder, or move the file away");
    }
    Error::new(format!("the folder can't be made: {error}"))
        .in_file(folder)
        .remedy("choose an output folder that you may write to")
}

fn write_temporary(folder: &Path, bytes: &[u8]) -> io::Result<NamedTempFile> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut builder = Builder::new();
    builder.prefix(".larix-").suffix(".part");
    // Readable as any new file is, within the user's umask; the crate's default is owner alone.
    #[cfg(unix)]
    let permissions = <fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666);
    #[cfg(unix)]
    builder.permissions(permissions);
    let mut file = builder.tempfile_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_all()?;
    Ok(file)
}

pub(super) fn unwritable(path: &Path, error: &io::Error, bytes: usize) -> Error {
    let remedy = match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            format!("free at least {} MB, or choose another output folder", bytes / 1_000_000 + 1)
        }
        _ => "choose an output folder that you may write to".to_owned(),
    };
    Error::new(format!("can't be written: {error}")).in_file(path).remedy(remedy)
}
