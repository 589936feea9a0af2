//! What was made once and may be wanted again, on disk under the hash of all that decides it.
//! Knows nothing of what it keeps.
//!
//! An entry is written to a temporary name and renamed; it carries a checksum (BLAKE3), and one
//! that does not hold is as good as none. Nothing here is an error: without a folder, or with a
//! full disk, everything is made anew. When the entries outgrow a gigabyte, those longest not
//! used go first; a temporary file that a killed run left goes after a day.

use std::fs;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime};

use bytes::Bytes;

/// Bytes kept at most.
const MOST_BYTES: u64 = 1 << 30;
/// What names of temporary files begin with, and how old one is that nobody will rename any more.
const TEMPORARY: &str = ".tmp";
const LEFT_AFTER: Duration = Duration::from_secs(24 * 3600);
/// Parts of one entry at most.
const MOST_PARTS: usize = 64;
const HASH_BYTES: usize = 32;

/// A folder of entries, or none.
#[derive(Debug, Clone, Default)]
pub struct Cache {
    folder: Option<PathBuf>,
}

/// The name of an entry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key(blake3::Hash);

impl Key {
    /// Of everything that decides the entry, in order; each part counts with its length.
    pub fn of<'a>(parts: impl IntoIterator<Item = &'a [u8]>) -> Key {
        let mut hasher = blake3::Hasher::new();
        for part in parts {
            hasher.update(&(part.len() as u64).to_le_bytes());
            hasher.update(part);
        }
        Key(hasher.finalize())
    }
}

impl Cache {
    /// Keeps nothing.
    pub fn off() -> Cache {
        Cache::default()
    }

    /// The user's own: `$XDG_CACHE_HOME/larix` on Linux, its like elsewhere.
    pub fn of_user() -> Cache {
        let place = directories::ProjectDirs::from("", "", "larix");
        Cache { folder: place.map(|p| p.cache_dir().to_path_buf()) }
    }

    pub fn is_on(&self) -> bool {
        self.folder.is_some()
    }

    pub fn in_folder(folder: &Path) -> Cache {
        Cache { folder: Some(folder.to_path_buf()) }
    }

    fn path(&self, key: Key) -> Option<PathBuf> {
        Some(self.folder.as_ref()?.join(format!("{}.bin", key.0.to_hex())))
    }

    /// The parts of an entry; `None` where it is missing or broken.
    pub fn get(&self, key: Key) -> Option<Vec<Bytes>> {
        let path = self.path(key)?;
        let bytes = fs::read(&path).ok()?;
        let parts = parts(&Bytes::from(bytes))?;
        if let Ok(file) = fs::File::options().append(true).open(&path) {
            // When it was last used; a file system that can't say so loses nothing.
            let _ = file.set_modified(SystemTime::now());
        }
        Some(parts)
    }

    /// Keeps an entry, if that is possible.
    pub fn put(&self, key: Key, parts: &[Bytes]) {
        if let Some(path) = self.path(key) {
            // A cache that can't be written is no cache.
            let _ = self.write(&path, parts);
        }
    }

    fn write(&self, path: &Path, parts: &[Bytes]) -> std::io::Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        fs::create_dir_all(folder)?;
        let bytes: usize = parts.iter().map(Bytes::len).sum();
        if bytes as u64 > MOST_BYTES {
            return Ok(());
        }
        let mut body = (parts.len() as u64).to_le_bytes().to_vec();
        parts.iter().for_each(|p| body.extend((p.len() as u64).to_le_bytes()));
        parts.iter().for_each(|p| body.extend_from_slice(p));
        make_room(folder, MOST_BYTES.saturating_sub(body.len() as u64))?;
        let mut file = tempfile::Builder::new().prefix(TEMPORARY).tempfile_in(folder)?;
        file.write_all(blake3::hash(&body).as_bytes())?;
        file.write_all(&body)?;
        file.persist(path)?;
        Ok(())
    }
}

/// The parts of an entry's bytes; `None` unless the checksum holds.
fn parts(bytes: &Bytes) -> Option<Vec<Bytes>> {
    let (hash, body) = bytes.split_at_checked(HASH_BYTES)?;
    if blake3::hash(body).as_bytes() != hash {
        return None;
    }
    let number = |at: usize| -> Option<usize> {
        let bytes = body.get(8 * at..8 * at + 8)?;
        usize::try_from(u64::from_le_bytes(bytes.try_into().ok()?)).ok()
    };
    let count = number(0).filter(|&n| n <= MOST_PARTS)?;
    let mut start = 8 * (count + 1);
    (1..=count)
        .map(|k| {
            let part = body.get(start..start.checked_add(number(k)?)?)?;
            start += part.len();
            Some(bytes.slice_ref(part))
        })
        .collect()
}

/// Drops the entries longest not used until those left take no more than `most` bytes.
fn make_room(folder: &Path, most: u64) -> std::io::Result<()> {
    let mut entries = Vec::new();
    for entry in fs::read_dir(folder)?.flatten() {
        let path = entry.path();
        let Ok(about) = entry.metadata() else { continue };
        let used = about.modified().unwrap_or(SystemTime::UNIX_EPOCH);
        if path.extension().is_some_and(|e| e == "bin") {
            entries.push((used, about.len(), path));
        } else if is_temporary(&path) && used.elapsed().is_ok_and(|age| age > LEFT_AFTER) {
            remove(&path)?;
        }
    }
    let mut total: u64 = entries.iter().map(|e| e.1).sum();
    entries.sort();
    for (_, bytes, path) in entries {
        if total <= most {
            break;
        }
        remove(&path)?;
        total -= bytes;
    }
    Ok(())
}

/// As [`Cache::put`] names what it has not finished.
fn is_temporary(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(TEMPORARY))
}

/// Another thread or run may be quicker.
fn remove(path: &Path) -> std::io::Result<()> {
    match fs::remove_file(path) {
        Err(e) if e.kind() == ErrorKind::NotFound => Ok(()),
        done => done,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some<const N: usize>(parts: [&'static [u8]; N]) -> [Bytes; N] {
        parts.map(Bytes::from_static)
    }

    fn key(name: &str) -> Key {
        Key::of([name.as_bytes()])
    }

    #[test]
    fn what_is_put_is_got() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(&folder.path().join("not/there/yet"));
        assert_eq!(cache.get(key("a")), None);
        cache.put(key("a"), &some([b"one", b"", b"three"]));
        assert_eq!(cache.get(key("a")).unwrap(), some([b"one", b"", b"three"]));
        assert_eq!(cache.get(key("b")), None);
        Cache::off().put(key("a"), &some([b"x"]));
        assert_eq!(Cache::off().get(key("a")), None);
    }

    #[test]
    fn parts_count_with_their_borders() {
        assert_ne!(Key::of([&b"ab"[..], b"c"]), Key::of([&b"a"[..], b"bc"]));
    }

    /// Cut anywhere, or with any byte changed, an entry is none.
    #[test]
    fn a_broken_entry_is_none() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        cache.put(key("a"), &some([b"some bytes", b"more"]));
        let path = cache.path(key("a")).unwrap();
        let whole = fs::read(&path).unwrap();
        for at in 0..whole.len() {
            fs::write(&path, &whole[..at]).unwrap();
            assert_eq!(cache.get(key("a")), None, "cut at {at}");
            let mut changed = whole.clone();
            changed[at] ^= 0x40;
            fs::write(&path, changed).unwrap();
            assert_eq!(cache.get(key("a")), None, "changed at {at}");
        }
        cache.put(key("a"), &some([b"anew"]));
        assert_eq!(cache.get(key("a")).unwrap(), some([b"anew"]));
    }

    #[test]
    fn the_longest_unused_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        for (age_s, name) in [(30, "old"), (20, "middle"), (10, "new")] {
            cache.put(key(name), &some([&[0; 1000]]));
            let file = fs::File::options().append(true).open(cache.path(key(name)).unwrap());
            let then = SystemTime::now() - Duration::from_secs(age_s);
            file.unwrap().set_modified(then).unwrap();
        }
        assert!(cache.get(key("old")).is_some(), "and is now the last used");
        make_room(folder.path(), 2200).unwrap();
        let kept = ["old", "middle", "new"].map(|n| cache.get(key(n)).is_some());
        assert_eq!(kept, [true, false, true]);
    }

    #[test]
    fn what_a_killed_run_left_goes_after_a_day() {
        let folder = tempfile::tempdir().unwrap();
        let left = |name: &str, age_s: u64| {
            let path = folder.path().join(name);
            fs::write(&path, [0; 100]).unwrap();
            let file = fs::File::options().append(true).open(&path).unwrap();
            file.set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
            path
        };
        let (old, new) = (left(".tmpOld", 100_000), left(".tmpNew", 1000));
        make_room(folder.path(), 1 << 20).unwrap();
        assert!(!old.exists() && new.exists());
    }

    /// Whoever makes room for the same entry at the same time.
    #[test]
    fn what_another_has_removed_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        remove(&folder.path().join("gone.bin")).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_is_no_error() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let cache = Cache::in_folder(&file.path().join("below"));
        cache.put(key("a"), &some([b"x"]));
        assert_eq!(cache.get(key("a")), None);
    }
}
