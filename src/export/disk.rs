//! Output files onto the disk, all of them or none.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Component, Path, PathBuf};

use bytes::Bytes;
use tempfile::{Builder, NamedTempFile};

use super::{Content, OutputFile};
use crate::diagnostic::{Error, Result};

/// Files on their way to the disk: each is written to a temporary file beside its destination and
/// flushed; [`Staged::commit`] renames them all over what was there before. Dropped before that,
/// or on an error, nothing earlier has changed, and temporary files and folders made on the way
/// are removed.
///
/// A rename that fails after others succeeded would leave a mixture; folders in the way, the
/// one foreseeable cause, are looked for first.
pub struct Staged {
    dir: PathBuf,
    paths: BTreeSet<PathBuf>,
    // Dropped before the folders, which must be empty to go.
    written: Vec<(NamedTempFile, PathBuf)>,
    made: MadeFolders,
}

impl Staged {
    /// An output folder, made where it is missing.
    pub fn new(dir: &Path) -> Result<Staged> {
        let mut made = MadeFolders(Vec::new());
        make_folder(dir, &mut made)?;
        Ok(Staged { dir: dir.into(), paths: BTreeSet::new(), written: Vec::new(), made })
    }

    /// Writes the files, making folders as needed; gives their bytes.
    pub fn add(&mut self, files: Vec<OutputFile<'_>>) -> Result<u64> {
        for file in &files {
            self.check_path(&file.path)?;
        }
        let mut all = 0;
        for OutputFile { path, content } in files {
            let path = self.dir.join(path);
            let parent = path.parent().unwrap_or(&self.dir).to_path_buf();
            make_folder(&parent, &mut self.made)?;
            if path.is_dir() {
                return Err(Error::new("is a folder, so no file can be written there")
                    .in_file(&path)
                    .remedy("move it away, or choose another output folder or name"));
            }
            let (temporary, bytes) = write_temporary(&parent, content)
                .map_err(|(e, reached)| unwritable(&path, &e, reached))?;
            all += bytes;
            self.written.push((temporary, path));
        }
        Ok(all)
    }

    /// Puts the files in their places.
    pub fn commit(mut self) -> Result<()> {
        for (temporary, path) in self.written.drain(..) {
            temporary.persist(&path).map_err(|e| unwritable(&path, &e.error, 0))?;
        }
        self.made.0.clear();
        Ok(())
    }

    /// Below the output folder, and each once.
    fn check_path(&mut self, path: &Path) -> Result<()> {
        let below = path.components().all(|c| matches!(c, Component::Normal(_)));
        if !below || path.file_name().is_none() {
            return Err(Error::new("is not a path below the output folder")
                .in_file(path)
                .remedy("choose an output name without `..` and without a leading `/`"));
        }
        if !self.paths.insert(path.into()) {
            return Err(Error::new("would be written twice")
                .in_file(path)
                .remedy("give each output a name of its own"));
        }
        Ok(())
    }
}

/// Writes `files` into `dir`, all of them or none.
pub fn write_all(dir: &Path, files: Vec<OutputFile<'_>>) -> Result<()> {
    let mut staged = Staged::new(dir)?;
    staged.add(files)?;
    staged.commit()
}

/// Whether [`write_all`] could write into `dir`, so that a long run need not find out at its end.
/// Leaves nothing behind.
pub fn check_writable(dir: &Path) -> Result<()> {
    let mut made = MadeFolders(Vec::new());
    make_folder(dir, &mut made)?;
    let nothing = Content::Bytes(Bytes::new());
    let probe = write_temporary(dir, nothing).map_err(|(e, _)| unwritable(dir, &e, 0))?;
    drop(probe);
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

/// The file and its bytes; on an error, the bytes that it had got to.
fn write_temporary(
    folder: &Path,
    content: Content<'_>,
) -> std::result::Result<(NamedTempFile, u64), (io::Error, u64)> {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let mut builder = Builder::new();
    builder.prefix(".larix-").suffix(".part");
    // Readable as any new file is, within the user's umask; the crate's default is owner alone.
    #[cfg(unix)]
    let permissions = <fs::Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o666);
    #[cfg(unix)]
    builder.permissions(permissions);
    let mut file = builder.tempfile_in(folder).map_err(|e| (e, 0))?;
    let written = content.write(file.as_file_mut()).and_then(|()| file.as_file().sync_all());
    let bytes = file.as_file().metadata().map_or(0, |m| m.len());
    match written {
        Ok(()) => Ok((file, bytes)),
        Err(e) => Err((e, bytes)),
    }
}

/// `bytes` are those that there was room for.
pub(super) fn unwritable(path: &Path, error: &io::Error, bytes: u64) -> Error {
    let remedy = match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            format!(
                "the disk was full after {} MB of it: free more, or choose another output folder",
                bytes / 1_000_000
            )
        }
        _ => "choose an output folder that you may write to".to_owned(),
    };
    Error::new(format!("can't be written: {error}")).in_file(path).remedy(remedy)
}
