//! Things by the group that they are in, on all threads.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use rayon::prelude::*;

/// Members of each group, in order; what is in no group is left out.
pub struct Groups {
    /// Where each group begins in `members`; one more than groups.
    start: Vec<u32>,
    members: Vec<u32>,
}

impl Groups {
    /// `group` of each thing in turn; `member` is what stands for the thing of that number.
    pub fn new(
        groups: usize,
        group: impl IndexedParallelIterator<Item = u32>,
        member: impl Fn(u32) -> u32 + Sync,
    ) -> Groups {
        let group: Vec<u32> = group.collect();
        let together = group.len().div_ceil(rayon::current_num_threads()).max(1 << 14);
        // How many of each group a run holds; then where the run's own begin.
        let mut counts: Vec<Vec<u32>> = (group.par_chunks(together))
            .map(|run| {
                let mut count = vec![0u32; groups];
                for &k in run {
                    if let Some(n) = count.get_mut(k as usize) {
                        *n += 1;
                    }
                }
                count
            })
            .collect();
        let mut start = Vec::with_capacity(groups + 1);
        let mut total = 0;
        for k in 0..groups {
            start.push(total);
            for count in &mut counts {
                total += std::mem::replace(&mut count[k], total);
            }
        }
        start.push(total);
        let members: Vec<AtomicU32> =
            rayon::iter::repeat_n(0, total as usize).map(AtomicU32::new).collect();
        let runs = group.par_chunks(together).zip(counts).enumerate();
        runs.for_each(|(run, (group, mut next))| {
            for (i, &k) in ((run * together) as u32..).zip(group) {
                if let Some(slot) = next.get_mut(k as usize) {
                    members[*slot as usize].store(member(i), Relaxed);
                    *slot += 1;
                }
            }
        });
        let members = members.into_par_iter().map(AtomicU32::into_inner).collect();
        Groups { start, members }
    }

    pub fn of(&self, group: usize) -> &[u32] {
        &self.members[self.start[group] as usize..self.start[group + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn members_stand_in_order_and_strays_are_left_out() {
        let n = 300_000u32;
        let groups = Groups::new(3, (0..n).into_par_iter().map(|i| i % 4), |i| 2 * i);
        for k in 0..3 {
            let expected: Vec<u32> = (0..n).filter(|i| i % 4 == k).map(|i| 2 * i).collect();
            assert_eq!(groups.of(k as usize), expected);
        }
        assert!(Groups::new(1, [5u32].into_par_iter(), |i| i).of(0).is_empty());
    }
}
