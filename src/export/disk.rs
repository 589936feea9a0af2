//! Output files onto the disk, all of them or none.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::{self, Scope};

use bytes::Bytes;
use tempfile::{Builder, TempDir};

use super::{Content, OutputFile};
use crate::diagnostic::{Error, Result};

/// Files on their way to the disk: each is written into a hidden folder beside its destination and
/// flushed; [`Staged::commit`] renames them all over what was there before. Dropped before that,
/// or on an error, nothing earlier has changed, and temporary files and folders made on the way
/// are removed; those of a killed run are removed by the next that writes there.
///
/// A rename that fails after others succeeded would leave a mixture; folders in the way, the
/// one foreseeable cause, are looked for first.
pub struct Staged {
    dir: PathBuf,
    paths: BTreeSet<PathBuf>,
    /// Written, and where to.
    written: Vec<(PathBuf, PathBuf)>,
    bytes: u64,
    /// Those of each folder that is written to. Dropped before the folders, which must be empty to
    /// go.
    scratch: BTreeMap<PathBuf, Scratch>,
    made: MadeFolders,
}

impl Staged {
    /// An output folder, made where it is missing.
    pub fn new(dir: &Path) -> Result<Staged> {
        let mut made = MadeFolders(Vec::new());
        make_folder(dir, &mut made)?;
        Ok(Staged {
            dir: dir.into(),
            paths: BTreeSet::new(),
            written: Vec::new(),
            bytes: 0,
            scratch: BTreeMap::new(),
            made,
        })
    }

    /// Writes the files, making folders as needed; gives their bytes.
    pub fn add(&mut self, files: Vec<OutputFile<'_>>) -> Result<u64> {
        /// Files open at a time, few enough for every system.
        const OPEN: usize = 64;
        for file in &files {
            self.check_path(&file.path)?;
        }
        let before = self.bytes;
        let mut open = Vec::new();
        for OutputFile { path, content } in files {
            let path = self.dir.join(path);
            let parent = path.parent().unwrap_or(&self.dir).to_path_buf();
            make_folder(&parent, &mut self.made)?;
            if path.is_dir() {
                return Err(Error::new("is a folder, so no file can be written there")
                    .in_file(&path)
                    .remedy("move it away, or choose another output folder or name"));
            }
            let scratch = self.scratch_in(&parent).map_err(|e| unwritable(&path, &e, 0))?;
            let temporary = scratch.next_path();
            let (file, bytes) = write(&temporary, content)
                .map_err(|(e, reached)| unwritable(&path, &e, self.bytes + reached))?;
            self.bytes += bytes;
            open.push((file, path.clone()));
            self.written.push((temporary, path));
            if open.len() >= OPEN {
                sync(std::mem::take(&mut open))?;
            }
        }
        sync(open)?;
        Ok(self.bytes - before)
    }

    /// Puts the files in their places.
    pub fn commit(mut self) -> Result<()> {
        for (temporary, path) in self.written.drain(..) {
            fs::rename(&temporary, &path).map_err(|e| unwritable(&path, &e, 0))?;
        }
        self.made.0.clear();
        Ok(())
    }

    fn scratch_in(&mut self, folder: &Path) -> io::Result<&mut Scratch> {
        if !self.scratch.contains_key(folder) {
            sweep(folder);
            self.scratch.insert(folder.into(), Scratch::new(folder)?);
        }
        self.scratch.get_mut(folder).ok_or_else(|| ErrorKind::NotFound.into())
    }

    /// Files of a scene of this name, whole, by levels or by places, that lie in the folder and are not
    /// among those added: an earlier run's, which would be taken for this one's. By name; none is touched.
    pub fn of_earlier_runs(&self, stem: &str) -> Vec<String> {
        let is_of_scene = |path: &PathBuf| path.parent() == Some(Path::new(""));
        let kinds: BTreeSet<&str> = self
            .paths
            .iter()
            .filter(|path| is_of_scene(path) && path.to_string_lossy().starts_with(stem))
            .filter_map(|path| path.extension()?.to_str())
            .collect();
        let is_left = |name: &String| {
            let rest = name.strip_prefix(stem).and_then(|rest| rest.rsplit_once('.'));
            let Some((forms, kind)) = rest else { return false };
            let is_form = |form: &str| {
                let number = |s: &str| !s.is_empty() && s.bytes().all(|b| b.is_ascii_digit());
                matches!(form, "impostor" | "terrain")
                    || ["LOD", "x", "y"].iter().any(|p| form.strip_prefix(p).is_some_and(number))
            };
            let mut forms = forms.split('_');
            forms.next() == Some("")
                && forms.all(is_form)
                && kinds.contains(kind)
                && !self.paths.contains(Path::new(name))
        };
        let mut names: Vec<String> = names_in(&self.dir).filter(is_left).collect();
        names.sort_unstable();
        names
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
    let probe = || {
        let mut scratch = Scratch::new(dir)?;
        let nothing = Content::Bytes(Bytes::new());
        write(&scratch.next_path(), nothing).map_err(|(e, _)| e)
    };
    probe().map(drop).map_err(|e| unwritable(dir, &e, 0))
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

const PREFIX: &str = ".larix-";
const SUFFIX: &str = ".part";
const LOCK: &str = "lock";

fn names_in(folder: &Path) -> impl Iterator<Item = String> {
    let entries = fs::read_dir(here(folder)).into_iter().flatten();
    entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok())
}

fn here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

/// A hidden folder for files on their way, whose lock is held as long as its run lives.
struct Scratch {
    _lock: File,
    folder: TempDir,
    files: usize,
}

impl Scratch {
    fn new(parent: &Path) -> io::Result<Scratch> {
        /// Another run may sweep it away before it is locked.
        const TRIES: usize = 100;
        for _ in 0..TRIES {
            let folder = Builder::new().prefix(PREFIX).suffix(SUFFIX).tempdir_in(here(parent))?;
            let path = folder.path().join(LOCK);
            let lock = match File::create(&path) {
                Ok(lock) => lock,
                Err(e) if e.kind() == ErrorKind::NotFound => continue,
                Err(e) => return Err(e),
            };
            // Where locks are not known, nobody sweeps.
            let _ = lock.lock();
            if path.exists() {
                return Ok(Scratch { _lock: lock, folder, files: 0 });
            }
        }
        Err(io::Error::other("temporary folders vanish as soon as they are made"))
    }

    fn next_path(&mut self) -> PathBuf {
        self.files += 1;
        self.folder.path().join(self.files.to_string())
    }
}

/// Removes what killed runs left: hidden folders that nobody holds the lock of. One that can't be
/// locked or removed stays.
fn sweep(folder: &Path) {
    for name in names_in(folder).filter(|n| n.starts_with(PREFIX) && n.ends_with(SUFFIX)) {
        let path = here(folder).join(name);
        // Killed before it had a lock.
        let _ = fs::remove_dir(&path);
        if let Ok(lock) = File::open(path.join(LOCK))
            && lock.try_lock().is_ok()
        {
            let _ = fs::remove_dir_all(path);
        }
    }
}

/// The file and its bytes, not flushed yet; on an error, the bytes that it had got to.
fn write(path: &Path, content: Content<'_>) -> std::result::Result<(File, u64), (io::Error, u64)> {
    let file = File::create_new(path).map_err(|e| (e, 0))?;
    let written = write_through(&file, content);
    let bytes = file.metadata().map_or(0, |m| m.len());
    match written {
        Ok(()) => Ok((file, bytes)),
        Err(e) => Err((e, bytes)),
    }
}

/// Flushes the files to be at these paths; several at a time, which take a disk little longer than
/// one.
fn sync(files: Vec<(File, PathBuf)>) -> Result<()> {
    const AT_A_TIME: usize = 16;
    let one = |(file, path): &(File, PathBuf)| {
        file.sync_all().map_err(|e| {
            let bytes = file.metadata().map_or(0, |m| m.len());
            unwritable(path, &e, bytes)
        })
    };
    let share = |k: usize| files.iter().skip(k).step_by(AT_A_TIME).try_for_each(one);
    thread::scope(|scope| {
        let spawn = |k: usize| (k, thread::Builder::new().spawn_scoped(scope, move || share(k)));
        let others: Vec<_> = (1..files.len().min(AT_A_TIME)).map(spawn).collect();
        let own = share(0);
        others.into_iter().fold(own, |all, (k, thread)| {
            let failed = || Err(Error::new("the flushing thread failed"));
            // Where no thread is to be had, it is done here.
            let one = thread.map_or_else(|_| share(k), |t| t.join().unwrap_or_else(|_| failed()));
            all.and(one)
        })
    })
}

/// Writes. A large file goes to the disk while it is written: the system would begin at its end only,
/// and the disk wait till then.
fn write_through(file: &File, content: Content<'_>) -> io::Result<()> {
    thread::scope(|scope| content.write(Flushed { file, scope, since: 0, flusher: None }))
}

/// A file with a thread that sends what was written to the disk, once that is much.
struct Flushed<'scope, 'env> {
    file: &'scope File,
    scope: &'scope Scope<'scope, 'env>,
    /// Bytes since the thread was last woken.
    since: usize,
    flusher: Option<SyncSender<()>>,
}

impl Flushed<'_, '_> {
    fn wake(&mut self) {
        if self.flusher.is_none() {
            let (wake, woken) = sync_channel(1);
            let file = self.file;
            let flush = move || woken.iter().for_each(|()| begin_flush(file));
            // Where no thread is to be had, all is flushed at the end.
            let thread = thread::Builder::new().spawn_scoped(self.scope, flush);
            self.flusher = thread.ok().map(|_| wake);
        }
        if let Some(wake) = &self.flusher {
            // Full where it has not begun the last.
            let _ = wake.try_send(());
        }
    }
}

/// Has the disk begin with what was written, without a wait for its end or for the file system's
/// journal, where the system can be asked to. What goes wrong, [`sync`] is told.
fn begin_flush(file: &File) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the descriptor is open as long as the file is borrowed.
    unsafe {
        let descriptor = std::os::fd::AsRawFd::as_raw_fd(file);
        libc::sync_file_range(descriptor, 0, 0, libc::SYNC_FILE_RANGE_WRITE);
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = file;
}

impl Write for Flushed<'_, '_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        /// Between two flushes.
        const MUCH: usize = 1 << 22;
        let written = self.file.write(bytes)?;
        self.since += written;
        if self.since >= MUCH {
            self.since = 0;
            self.wake();
        }
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Flushed<'_, '_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// A file that grows beyond what this process may write is told as an error, and cleared away, rather
/// than ending the process. For the start of a program.
pub fn survive_file_limits() {
    #[cfg(all(unix, target_env = "gnu"))]
    // SAFETY: no handler is called.
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}

/// `bytes` are those of all files that there was room for.
pub(super) fn unwritable(path: &Path, error: &io::Error, bytes: u64) -> Error {
    let remedy = match error.kind() {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => {
            format!(
                "the disk was full after {:.1} MB of output: free more, or choose another output folder",
                bytes as f64 * 1e-6
            )
        }
        ErrorKind::FileTooLarge => {
            "no file may be so large here: raise `ulimit -f`, or choose another output folder"
                .to_owned()
        }
        _ => "choose an output folder that you may write to".to_owned(),
    };
    Error::new(format!("can't be written: {error}")).in_file(path).remedy(remedy)
}
