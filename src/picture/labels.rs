//! Names in two columns beside a figure: none lies over another, and lines to their points cross as little as can be.

use super::lettering::LINE;

/// The names on one side.
#[derive(Clone, Debug, Default)]
pub(super) struct Column {
    /// From the top down.
    pub(super) slots: Vec<Slot>,
}

/// The place of a name.
#[derive(Clone, Debug)]
pub(super) struct Slot {
    pub(super) item: usize,
    /// Width of the name in pixels.
    width: usize,
    /// Where its point is.
    dot: [f32; 2],
    /// Height of the middle of the name.
    pub(super) y: f32,
}

impl Column {
    pub(super) fn width(&self) -> usize {
        self.slots.iter().map(|s| s.width).max().unwrap_or(0)
    }

    /// `edge`: where the lines end.
    fn arrange(&mut self, height: usize, edge: f32) {
        self.slots.sort_by(|a, b| a.dot[1].total_cmp(&b.dot[1]).then(a.item.cmp(&b.item)));
        let count = self.slots.len();
        let step = (LINE as f32 * 0.9).min(height as f32 / count.max(1) as f32);
        // Heights as near as can be to those of the points, `step` apart: means of blocks that push each other.
        let mut blocks: Vec<(f32, usize)> = Vec::new();
        for (i, slot) in self.slots.iter().enumerate() {
            let mut block = (slot.dot[1] - i as f32 * step, 1);
            while let Some(&(mean, size)) = blocks.last().filter(|(mean, _)| *mean > block.0) {
                block = ((mean * size as f32 + block.0 * block.1 as f32) / (size + block.1) as f32, size + block.1);
                blocks.pop();
            }
            blocks.push(block);
        }
        let lowest = (height as f32 - (count as f32 - 0.5) * step).max(step / 2.0);
        let starts = blocks.iter().flat_map(|&(mean, size)| std::iter::repeat_n(mean.clamp(step / 2.0, lowest), size));
        let heights: Vec<f32> = starts.enumerate().map(|(i, start)| start + i as f32 * step).collect();
        self.slots.iter_mut().zip(&heights).for_each(|(slot, y)| slot.y = *y);
        for _ in 0..count {
            let mut crossed = false;
            for i in 1..count {
                let ends = [0, 1].map(|k| [edge, heights[i - 1 + k]]);
                if cross(self.slots[i - 1].dot, ends[0], self.slots[i].dot, ends[1]) {
                    self.slots.swap(i - 1, i);
                    self.slots[i - 1].y = heights[i - 1];
                    self.slots[i].y = heights[i];
                    crossed = true;
                }
            }
            if !crossed {
                break;
            }
        }
    }
}

/// Whether the lines a–b and c–d cross.
pub(super) fn cross(a: [f32; 2], b: [f32; 2], c: [f32; 2], d: [f32; 2]) -> bool {
    let side = |p: [f32; 2], q: [f32; 2], r: [f32; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

/// Splits names into those left and right of `middle`; where a side has more than find room, those nearest to the middle change over.
///
/// `dots`: number and place of each point, from the upper left corner of the figure.
pub(super) fn columns(
    dots: impl Iterator<Item = (usize, [f32; 2])>,
    width: &dyn Fn(usize) -> usize,
    height: usize,
    middle: f32,
) -> (Column, Column) {
    let mut all: Vec<Slot> = dots.map(|(item, dot)| Slot { item, width: width(item), dot, y: 0.0 }).collect();
    all.sort_by(|a, b| a.dot[0].total_cmp(&b.dot[0]).then(a.item.cmp(&b.item)));
    let room = (height / LINE).max(1);
    let natural = all.iter().filter(|s| s.dot[0] < middle).count();
    let (count, fewest) = (all.len(), all.len().saturating_sub(room));
    let split = if count > 2 * room { count / 2 } else { natural.clamp(fewest, room.max(fewest)) };
    let mut right = Column { slots: all.split_off(split.min(count)) };
    let mut left = Column { slots: all };
    left.arrange(height, 0.0);
    right.arrange(height, 2.0 * middle);
    (left, right)
}
