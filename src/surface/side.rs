//! Frames side by side: a number of every frame in one row of lanes, and the way from points frame by frame to such rows and back.
//!
//! Nothing here fuses a multiplication with an addition, so the bits are the same with any vector instructions.

use super::apply::Avx2;
use std::ops::{Add, AddAssign, Div, Mul, Sub};

/// Points or vectors of the frames in memory: axis by axis.
pub(super) type Side<const W: usize> = [[f32; W]; 3];

/// Vertices that are worked on before their lanes are handed out to the frames: in one loop the compiler would mix up the two shapes.
pub(super) const GROUP: usize = 32;

/// A number of each frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<const W: usize>(pub(super) [f32; W]);

macro_rules! row_operator {
    ($($operator:ident $function:ident $sign:tt),*) => {$(
        impl<const W: usize> $operator for Row<W> {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                let mut out = self.0;
                for lane in 0..W {
                    out[lane] = self.0[lane] $sign other.0[lane];
                }
                Self(out)
            }
        }
        impl<const W: usize> $operator<f32> for Row<W> {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: f32) -> Self {
                self $sign Self([other; W])
            }
        }
    )*};
}
row_operator!(Add add +, Sub sub -, Mul mul *, Div div /);

impl<const W: usize> AddAssign for Row<W> {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const W: usize> Row<W> {
    pub(super) const ZERO: Self = Self([0.0; W]);

    /// The larger of each number and `least`; `least` where it is none.
    #[inline(always)]
    pub(super) fn at_least(self, least: f32) -> Self {
        let mut out = self.0;
        for x in &mut out {
            *x = if *x > least { *x } else { least };
        }
        Self(out)
    }

    /// 1 / √x.
    #[inline(always)]
    pub(super) fn inverse_root(self) -> Self {
        Self([1.0; W]) / Self(self.0.map(f32::sqrt))
    }
}

/// A point or vector of each frame.
pub(super) type Vector<const W: usize> = [Row<W>; 3];

#[inline(always)]
pub(super) fn vector<const W: usize>(side: &Side<W>) -> Vector<W> {
    [Row(side[0]), Row(side[1]), Row(side[2])]
}

#[inline(always)]
pub(super) fn minus<const W: usize>(a: Vector<W>, b: Vector<W>) -> Vector<W> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
pub(super) fn cross<const W: usize>(a: Vector<W>, b: Vector<W>) -> Vector<W> {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline(always)]
pub(super) fn dot<const W: usize>(a: Vector<W>, b: Vector<W>) -> Row<W> {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Asks for a point that is needed soon: neighbours on the surface may be far apart in the file.
#[inline(always)]
pub(super) fn prefetch<const W: usize>(point: &Side<W>) {
    #[cfg(target_arch = "x86_64")]
    for line in (0..size_of::<Side<W>>()).step_by(64) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint, of which nothing is read.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(point).cast::<i8>().wrapping_add(line)) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = point;
}

/// Lays points beside each other: `points` receives those of every frame from `first` on; lanes without a frame repeat the last one.
#[inline(always)]
pub(super) fn gather<const W: usize>(avx2: Option<Avx2>, frames: &[&[[f32; 3]]], first: usize, points: &mut [Side<W>]) {
    let lanes: [&[[f32; 3]]; W] = std::array::from_fn(|lane| &frames[lane.min(frames.len() - 1)][first..first + points.len()]);
    let done = whole_squares::<W>(avx2, points.len());
    #[cfg(target_arch = "x86_64")]
    if done > 0 {
        // SAFETY: whole squares are only counted with the proof that the processor has AVX2.
        unsafe { squares::gather(lanes.as_slice(), points[..done].as_flattened_mut().as_flattened_mut()) };
    }
    for (lane, frame) in lanes.iter().enumerate() {
        for (point, p) in points[done..].iter_mut().zip(&frame[done..]) {
            for axis in 0..3 {
                point[axis][lane] = p[axis];
            }
        }
    }
}

/// Hands out lanes to frames: `out[lane]` receives the group from `begin` on; lanes whose output is empty are dropped.
#[inline(always)]
pub(super) fn hand_out<const W: usize>(avx2: Option<Avx2>, group: &[Side<W>], begin: usize, out: &mut [&mut [[f32; 3]]; W]) {
    let done = whole_squares::<W>(avx2, group.len());
    #[cfg(target_arch = "x86_64")]
    if done > 0 {
        // SAFETY: whole squares are only counted with the proof that the processor has AVX2.
        unsafe { squares::hand_out(group[..done].as_flattened().as_flattened(), begin, out.as_mut_slice()) };
    }
    for (lane, frame) in out.iter_mut().enumerate() {
        for (to, point) in frame.get_mut(begin + done..).into_iter().flatten().zip(&group[done..]) {
            *to = [point[0][lane], point[1][lane], point[2][lane]];
        }
    }
}

/// How many points fill squares of eight lanes.
#[inline(always)]
fn whole_squares<const W: usize>(avx2: Option<Avx2>, points: usize) -> usize {
    if avx2.is_some() && W == 8 { points / W * W } else { 0 }
}

/// Eight points of eight frames are three squares of eight by eight numbers; each is turned by itself. The compiler finds no such shuffles.
#[cfg(target_arch = "x86_64")]
mod squares {
    use std::arch::x86_64::{
        __m256, _mm256_loadu_ps, _mm256_permute2f128_ps, _mm256_shuffle_ps, _mm256_storeu_ps, _mm256_unpackhi_ps,
        _mm256_unpacklo_ps,
    };

    /// Points of eight frames into rows of eight lanes, three of them for a point: a multiple of eight points.
    #[target_feature(enable = "avx2")]
    pub(super) fn gather(frames: &[&[[f32; 3]]], rows: &mut [f32]) {
        for (k, square) in rows.as_chunks_mut::<64>().0.iter_mut().enumerate() {
            let from: [__m256; 8] = std::array::from_fn(|lane| load(&frames[lane].as_flattened()[8 * k..]));
            for (to, row) in square.as_chunks_mut().0.iter_mut().zip(transposed(from)) {
                store(to, row);
            }
        }
    }

    /// The way back, to the frames from the point `begin` on; frames without points are left out.
    #[target_feature(enable = "avx2")]
    pub(super) fn hand_out(rows: &[f32], begin: usize, out: &mut [&mut [[f32; 3]]]) {
        for (k, square) in rows.as_chunks::<64>().0.iter().enumerate() {
            let lanes = transposed(std::array::from_fn(|row| load(&square[8 * row..])));
            for (frame, lane) in out.iter_mut().zip(lanes) {
                let at = 3 * begin + 8 * k;
                if let Some(to) = frame.as_flattened_mut().get_mut(at..).and_then(|to| to.first_chunk_mut()) {
                    store(to, lane);
                }
            }
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(from: &[f32]) -> __m256 {
        let from: &[f32; 8] = from.first_chunk().expect("a whole row");
        // SAFETY: eight numbers, which need not be aligned.
        unsafe { _mm256_loadu_ps(from.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn store(to: &mut [f32; 8], row: __m256) {
        // SAFETY: room for eight numbers, which need not be aligned.
        unsafe { _mm256_storeu_ps(to.as_mut_ptr(), row) };
    }

    /// Rows as columns: pairs of rows, then pairs of pairs, then halves.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn transposed(r: [__m256; 8]) -> [__m256; 8] {
        let twos: [[__m256; 2]; 4] =
            [0, 2, 4, 6].map(|k| [_mm256_unpacklo_ps(r[k], r[k + 1]), _mm256_unpackhi_ps(r[k], r[k + 1])]);
        let fours = |a: [__m256; 2], b: [__m256; 2]| {
            [
                _mm256_shuffle_ps::<0x44>(a[0], b[0]),
                _mm256_shuffle_ps::<0xee>(a[0], b[0]),
                _mm256_shuffle_ps::<0x44>(a[1], b[1]),
                _mm256_shuffle_ps::<0xee>(a[1], b[1]),
            ]
        };
        let (upper, lower) = (fours(twos[0], twos[1]), fours(twos[2], twos[3]));
        std::array::from_fn(|k| {
            let (a, b) = (upper[k % 4], lower[k % 4]);
            if k < 4 { _mm256_permute2f128_ps::<0x20>(a, b) } else { _mm256_permute2f128_ps::<0x31>(a, b) }
        })
    }
}
