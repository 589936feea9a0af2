//! Numbers that take long to find, found where an earlier run kept them.

use bytes::Bytes;

use crate::cache::{Cache, Key};
use crate::diagnostic::Result;

/// What is kept under a key, where that is `count` numbers.
pub(super) fn get(cache: &Cache, key: Key, count: usize) -> Option<Vec<f32>> {
    let bytes = cache.get(key)?.into_iter().next()?;
    let kept: Vec<f32> = bytemuck::pod_collect_to_vec(&bytes[..]);
    (kept.len() == count).then_some(kept)
}

pub(super) fn put(cache: &Cache, key: Key, numbers: &[f32]) {
    cache.put(key, &[Bytes::copy_from_slice(bytemuck::cast_slice(numbers))]);
}

/// What `find` gives, `count` numbers, or what is kept. Without a cache no key is made.
///
/// # Errors
/// Those of `key` and of `find`.
pub(super) fn or_find(
    cache: &Cache,
    key: impl FnOnce() -> Result<Key>,
    count: usize,
    find: impl FnOnce() -> Result<Vec<f32>>,
) -> Result<Vec<f32>> {
    if !cache.is_on() {
        return find();
    }
    let key = key()?;
    if let Some(kept) = get(cache, key, count) {
        return Ok(kept);
    }
    let found = find()?;
    put(cache, key, &found);
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_once_and_anew_where_what_is_kept_is_broken() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::in_folder(folder.path());
        let key = Key::of([b"of these".as_slice()]);
        let mut found = 0;
        let mut ask = |cache: &Cache, count: usize| {
            let find = || {
                found += 1;
                Ok(vec![0.1 + found as f32; count])
            };
            (or_find(cache, || Ok(key), count, find).unwrap(), found)
        };
        let first = ask(&cache, 3);
        assert_eq!(first, (vec![1.1; 3], 1));
        assert_eq!(ask(&cache, 3), first);
        assert_eq!(ask(&Cache::off(), 3).1, 2);
        assert_eq!(ask(&cache, 4), (vec![3.1; 4], 3), "of another number");
        cache.put(key, &[]);
        assert_eq!(ask(&cache, 4).1, 4);
    }
}
