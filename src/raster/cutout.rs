//! Pictures that a mask cuts out: cover kept where texels are coarse and in smaller versions.

use super::Picture;

/// Weight of the mean about a texel in its rank, so that what passes is in patches, not in dots.
const TOGETHER: f32 = 0.15;
/// How fast alpha goes from hidden to seen with a texel's rank.
const STEEP: f32 = 1.5;
/// What hides a block that shows nothing.
const CLOSED: f32 = 1.0;

/// Alpha (0…1, rows of `width`) so that, cut at one half, it shows about as much of every block of
/// `block` × `block` texels as the mean of `alpha` there: the texels with most of it. Cut as it is,
/// foliage of more than half a texel everywhere would be solid, and thinner foliage gone.
pub fn spread(alpha: &[f32], width: usize, block: usize) -> Vec<f32> {
    let height = alpha.len() / width.max(1);
    let (columns, rows) = (width.div_ceil(block), height.div_ceil(block));
    let at = |x: usize, y: usize| y * width + x;
    let rank: Vec<f32> = (0..alpha.len())
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let (xs, ys) = (
                [x.saturating_sub(1), x, (x + 1).min(width - 1)],
                [y.saturating_sub(1), y, (y + 1).min(height - 1)],
            );
            let sum: f32 = ys.iter().flat_map(|&y| xs.iter().map(move |&x| alpha[at(x, y)])).sum();
            alpha[i] + TOGETHER * sum / 9.0
        })
        .collect();
    // The rank between what passes and what does not.
    let mut of = Vec::new();
    let mut limit = vec![CLOSED; columns * rows];
    for (b, limit) in limit.iter_mut().enumerate() {
        let (left, top) = (b % columns * block, b / columns * block);
        of.clear();
        let mut cover = 0.0;
        for y in top..(top + block).min(height) {
            for x in left..(left + block).min(width) {
                of.push(rank[at(x, y)]);
                cover += alpha[at(x, y)];
            }
        }
        of.sort_by(|a, b| b.total_cmp(a));
        let shown = (cover.round() as usize).min(of.len());
        if of[0] > 0.0 {
            let last = if shown == 0 { of[0] + 0.1 } else { of[shown - 1] };
            let next = of.get(shown).map_or(last - 0.1, |n| *n);
            *limit = (0.5 * (last + next)).max(1e-3);
        }
    }
    let limit_at = |x: usize, y: usize| {
        let place = |k: usize, count: usize| {
            let k = ((k as f32 + 0.5) / block as f32 - 0.5).clamp(0.0, (count - 1) as f32);
            (k as usize, (k as usize + 1).min(count - 1), k.fract())
        };
        let ((x0, x1, s), (y0, y1, t)) = (place(x, columns), place(y, rows));
        let row = |y: usize| {
            let (a, b) = (limit[y * columns + x0], limit[y * columns + x1]);
            a + (b - a) * s
        };
        row(y0) + (row(y1) - row(y0)) * t
    };
    (0..alpha.len())
        .map(|i| {
            let over = rank[i] - limit_at(i % width, i / width);
            if alpha[i] > 0.0 { (0.5 + STEEP * over).clamp(0.0, 1.0) } else { 0.0 }
        })
        .collect()
}

/// Pixels about a leaf that get alpha, in a picture of so many a side; finer ones have as many more
/// between their leaves.
const NEAR: (usize, usize) = (32, 512);
/// Most alpha that a pixel gets which is not seen, in parts of the mask's cutoff.
const MOST_HIDDEN: f32 = 0.95;

/// Gives pixels that a mask hides so much alpha, still below `cutoff`, that smaller versions made
/// by averaging blocks show about the same share of the picture as the picture itself: none more than
/// `most` times as much, so that of the smallest, where leaves and the gaps about a twig are in one
/// pixel, as much as can be stays. What is near leaves gets more, what is far from any none, so that
/// outlines stay.
///
/// Cutouts made of averages thin out otherwise (Castaño 2010, who scales alpha on every level; a
/// file holds the first level alone).
pub fn keep_cover(picture: &mut Picture, cutoff: f32, most: f32) {
    let (w, h) = (picture.width as usize, picture.height as usize);
    let least = cutoff * 255.0;
    let seen = picture.data.iter().filter(|p| f32::from(p[3]) >= least).count();
    if seen == 0 || seen == picture.data.len() {
        return;
    }
    let near = density(picture, NEAR.0 * (w.min(h) / NEAR.1).max(1));
    let raised = |alpha: u8, near: f32, gain: f32| -> f32 {
        let alpha = f32::from(alpha);
        let hidden = (gain * near).min(MOST_HIDDEN) * (least - 1.0);
        if alpha >= least { alpha } else { alpha.max(hidden) }
    };
    // What is whole shows on every level.
    let whole = near.iter().filter(|n| **n > 0.99).count();
    let parts = |seen: usize, all: usize| seen as f32 / all as f32;
    let is_whole = parts(whole, w * h);
    let most = is_whole + most * (parts(seen, w * h) - is_whole).max(0.0);
    // Whether with that gain a smaller version shows too much.
    let is_too_full = |gain: f32| -> bool {
        let alphas = picture.data.iter().zip(&near);
        let mut level: Vec<f32> = alphas.map(|(p, n)| raised(p[3], *n, gain)).collect();
        let (mut w, mut h) = (w, h);
        loop {
            let (nw, nh) = (w / 2, h / 2);
            if nw < 4 || nh < 4 {
                return false;
            }
            let mean = |x: usize, y: usize| {
                let i = 2 * y * w + 2 * x;
                0.25 * (level[i] + level[i + 1] + level[i + w] + level[i + w + 1])
            };
            level = (0..nw * nh).map(|i| mean(i % nw, i / nw)).collect();
            (w, h) = (nw, nh);
            let passed = level.iter().filter(|a| **a >= least).count();
            if parts(passed, w * h) > most {
                return true;
            }
        }
    };
    let (mut low, mut high) = (0.0f32, 8.0f32);
    for _ in 0..8 {
        let gain = 0.5 * (low + high);
        if is_too_full(gain) { high = gain } else { low = gain }
    }
    for (pixel, near) in picture.data.iter_mut().zip(&near) {
        pixel[3] = raised(pixel[3], *near, low).round() as u8;
    }
}

/// Mean alpha about each pixel, 0…1: the box of `radius` pixels to each side, twice.
fn density(picture: &Picture, radius: usize) -> Vec<f32> {
    let (w, h) = (picture.width as usize, picture.height as usize);
    let mut field: Vec<f32> = picture.data.iter().map(|p| f32::from(p[3]) / 255.0).collect();
    let mut line = Vec::new();
    let mut smooth = |field: &mut [f32], start: usize, step: usize, count: usize| {
        line.clear();
        line.push(0.0f64);
        for k in 0..count {
            line.push(line[k] + f64::from(field[start + k * step]));
        }
        for k in 0..count {
            let (a, b) = (k.saturating_sub(radius), (k + radius + 1).min(count));
            field[start + k * step] = ((line[b] - line[a]) / (b - a) as f64) as f32;
        }
    };
    for _ in 0..2 {
        (0..h).for_each(|y| smooth(&mut field, y * w, 1, w));
        (0..w).for_each(|x| smooth(&mut field, x, w, h));
    }
    field
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    /// Shares seen of blocks with ever more leaves, from 1/16 to 15/16, at `side` blocks of 16 texels.
    fn wedge() -> (Vec<f32>, usize) {
        let mut draws = Seed::new(3).draws();
        let (blocks, side) = (15, 16);
        let width = blocks * side;
        let alpha = (0..width * side)
            .map(|i| {
                let share = ((i % width / side) as f32 + 1.0) / 16.0;
                (share + draws.between(-0.06, 0.06)).clamp(0.0, 1.0)
            })
            .collect();
        (alpha, width)
    }

    #[test]
    fn thin_and_dense_parts_keep_their_cover() {
        let (alpha, width) = wedge();
        let got = spread(&alpha, width, 5);
        for block in 0..15 {
            let of = |a: &[f32]| -> Vec<f32> {
                (0..a.len()).filter(|i| i % width / 16 == block).map(|i| a[i]).collect()
            };
            let seen = of(&got).iter().filter(|a| **a >= 0.5).count() as f32 / 256.0;
            let wanted = of(&alpha).iter().sum::<f32>() / 256.0;
            // Cut as it was, it would be 0 or 1.
            assert!((seen - wanted).abs() < 0.1, "{block}: {seen} {wanted}");
        }
        assert!(
            got.iter().zip(&alpha).all(|(g, a)| (0.0..=1.0).contains(g) && (*a > 0.0 || *g == 0.0))
        );
    }

    #[test]
    fn what_is_whole_or_empty_stays() {
        let half: Vec<f32> = (0..40 * 30).map(|i| f32::from(u8::from(i % 40 < 20))).collect();
        let got = spread(&half, 40, 7);
        assert!(got.iter().zip(&half).all(|(g, a)| (*g >= 0.5) == (*a == 1.0)));
        assert!(spread(&[], 0, 5).is_empty());
        assert_eq!(spread(&[1.0], 1, 5).len(), 1);
    }

    #[test]
    fn smaller_versions_of_thin_twigs_keep_their_cover() {
        // Dots, ever more of them, nowhere half.
        let mut draws = Seed::new(5).draws();
        let mut picture = Picture::filled(256, 256, [90, 80, 70, 0]);
        for (x, y) in (0..256).flat_map(|y| (0..256).map(move |x| (x, y))) {
            if draws.between(0.0, 1.0) < 0.35 * x as f32 / 256.0 {
                picture.set(x, y, [90, 80, 70, 255]);
            }
        }
        let share = |level: &[f32]| {
            level.iter().filter(|a| **a >= 127.5).count() as f32 / level.len() as f32
        };
        let small = |picture: &Picture| {
            let (mut level, mut w): (Vec<f32>, _) =
                (picture.data.iter().map(|p| f32::from(p[3])).collect(), 256);
            for _ in 0..3 {
                w /= 2;
                let at = |x: usize, y: usize| level[y * 2 * w + x];
                let mean = |i: usize| {
                    let (x, y) = (i % w * 2, i / w * 2);
                    0.25 * (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1))
                };
                level = (0..w * w).map(mean).collect();
            }
            share(&level)
        };
        let seen = |picture: &Picture| -> f32 {
            share(&picture.data.iter().map(|p| f32::from(p[3])).collect::<Vec<_>>())
        };
        let wanted = seen(&picture);
        assert!(small(&picture) < 0.01 && wanted > 0.15);
        keep_cover(&mut picture, 0.5, 1.0);
        assert_eq!(seen(&picture), wanted);
        // No version in between shows more than the picture, so not quite as much.
        let got = small(&picture);
        assert!((0.7..1.05).contains(&(got / wanted)), "{got} {wanted}");
    }
}
