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

/// Groups faces that have the same three vertices: distributes them over their smallest vertex by counting, and sorts
/// the few of each.
#[must_use]
pub fn group_faces(faces: &[[u32; 3]]) -> FaceGroups {
    let vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
    let mut end = vec![0u32; vertices];
    let smallest = |face: &[u32; 3]| face[0].min(face[1]).min(face[2]);
    for face in faces {
        end[smallest(face) as usize] += 1;
    }
    let mut total = 0;
    for count in &mut end {
        total += std::mem::replace(count, total);
    }
    let mut order = vec![0u32; faces.len()];
    for (face, f) in faces.iter().zip(0u32..) {
        let next = &mut end[smallest(face) as usize];
        order[*next as usize] = f;
        *next += 1;
    }
    let key = |f: u32| {
        let mut key = faces[f as usize];
        key.sort_unstable();
        key
    };
    let mut start = Vec::with_capacity(faces.len() + 1);
    let mut begin = 0;
    for end in end {
        let among = &mut order[begin as usize..end as usize];
        among.sort_unstable_by_key(|&f| (key(f), f));
        let mut last = None;
        for (&f, at) in among.iter().zip(begin..) {
            let key = key(f);
            if last.replace(key) != Some(key) {
                start.push(at);
            }
        }
        begin = end;
    }
    start.push(total);
    FaceGroups { order, start }
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
