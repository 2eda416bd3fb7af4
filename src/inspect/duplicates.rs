/// Faces grouped by their three vertices, whatever the order.
#[derive(Debug, Clone, Default)]
pub struct FaceGroups {
    /// Faces sorted by group, and by index within a group.
    order: Vec<u32>,
    /// Where each group starts in `order`, and the end.
    start: Vec<u32>,
}

impl FaceGroups {
    /// How many different faces there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there is no face.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The groups in order of their vertices; each lists its faces by index.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.start.windows(2).map(|w| &self.order[w[0] as usize..w[1] as usize])
    }
}

/// Groups faces that have the same three vertices.
#[must_use]
pub fn group_faces(faces: &[[u32; 3]]) -> FaceGroups {
    let mut sorted: Vec<([u32; 3], u32)> = faces
        .iter()
        .zip(0u32..)
        .map(|(&face, f)| {
            let mut key = face;
            key.sort_unstable();
            (key, f)
        })
        .collect();
    sorted.sort_unstable();
    let mut groups = FaceGroups { order: sorted.iter().map(|&(_, f)| f).collect(), start: Vec::new() };
    let mut last = None;
    for (&(key, _), at) in sorted.iter().zip(0u32..) {
        if last != Some(key) {
            groups.start.push(at);
            last = Some(key);
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
    groups.start.push(sorted.len() as u32);
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_with_the_same_vertices_are_one_group_whatever_the_order() {
        let groups = group_faces(&[[2, 1, 0], [0, 1, 3], [0, 1, 2]]);
        assert_eq!(groups.iter().collect::<Vec<_>>(), [&[0u32, 2][..], &[1][..]]);
        assert_eq!(groups.len(), 2);
        assert!(group_faces(&[]).is_empty());
    }
}
