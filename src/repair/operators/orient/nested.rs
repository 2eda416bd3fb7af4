use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::inspect::Solid;

/// How closed parts that lie in others are wound.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize, ToSchema, clap::ValueEnum)]
#[serde(rename_all = "snake_case")]
#[value(rename_all = "snake_case")]
pub enum Nested {
    /// As they were: what looks inward in a solid is a cavity, what looks outward a solid of its own.
    #[default]
    Keep,
    /// Each layer against the one around it: what lies in a solid is a cavity, what lies in a cavity a solid.
    Alternate,
}

/// What is made of closed parts, by how deep they lie in others.
#[derive(Debug, Default)]
pub(super) struct Layers {
    /// Whether to turn each part.
    pub turn: Vec<bool>,
    /// Parts at odd depth that look inward, and did.
    pub cavities_kept: u64,
    /// Parts at odd depth that look outward: solids that overlap the one around them.
    pub solids_inside_solids: u64,
}

impl Layers {
    /// Decides by the sign of each part's volume and by the parts that it lies in.
    ///
    /// At even depth a part is turned to positive volume. At odd depth it is a cavity where it looks inward. Where the part
    /// around it was turned and it looked the other way than that one, it was a cavity of a solid that was inside out as a
    /// whole, so it is turned too.
    pub fn new(solids: &[Solid], containers: &[Option<Vec<u32>>], nested: Nested) -> Self {
        let mut layers = Self { turn: vec![false; solids.len()], ..Self::default() };
        let depth = |part: usize| containers[part].as_ref().map(Vec::len);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter_map(|p| Some((depth(p)?, p))).collect();
        order.sort_unstable();
        for (level, part) in order {
            let inward = solids[part].volume < 0.0;
            if level % 2 == 0 {
                layers.turn[part] = inward;
                continue;
            }
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) == Some(level - 1));
            let was_cavity = around.is_some_and(|&c| layers.turn[c as usize]);
            layers.turn[part] = !inward && (was_cavity || nested == Nested::Alternate);
            if !layers.turn[part] {
                *(if inward { &mut layers.cavities_kept } else { &mut layers.solids_inside_solids }) += 1;
            }
        }
        layers
    }

    /// Decides anew on parts in closed ones that are themselves `surrounded` by walls with holes, so that all that is in
    /// them lies one layer deeper than closed parts alone tell.
    pub fn correct_within(&mut self, surrounded: &[bool], solids: &[Solid], containers: &[Option<Vec<u32>>]) {
        let depth = |part: usize| containers[part].as_ref().map_or(0, Vec::len);
        let deeper = |part: usize| containers[part].iter().flatten().any(|&c| surrounded[c as usize]);
        let mut order: Vec<(usize, usize)> = (0..solids.len()).filter(|&p| deeper(p)).map(|p| (depth(p), p)).collect();
        order.sort_unstable();
        for (depth_here, part) in order {
            let inward = solids[part].volume < 0.0;
            let around = containers[part].iter().flatten().find(|&&c| depth(c as usize) + 1 == depth_here);
            let was_cavity = around.is_some_and(|&c| self.turn[c as usize]);
            self.turn[part] = if depth_here % 2 == 1 { inward } else { !inward && was_cavity };
        }
    }
}
