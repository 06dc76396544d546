//! Vertices stored by coordinate, as SIMD instructions read them.

use glam::{DMat3, DVec3};

/// The number of doubles that the widest instructions process at once.
pub(super) const LANES: usize = 8;

/// The coordinates of [`LANES`] vertices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Group {
    pub(super) x: [f64; LANES],
    pub(super) y: [f64; LANES],
    pub(super) z: [f64; LANES],
}

/// Vertices stored by coordinate, in groups. The last group is filled up with copies of the first
/// vertex. The copies never win a search, because the first vertex has a lower index and wins the
/// tie.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Columns(Vec<Group>);

impl Columns {
    pub(crate) fn new(vertices: &[DVec3]) -> Self {
        let group = |some: &[DVec3]| {
            let lane = |k: usize| *some.get(k).unwrap_or(&vertices[0]);
            let column = |coordinate: fn(DVec3) -> f64| std::array::from_fn(|k| coordinate(lane(k)));
            Group { x: column(|v| v.x), y: column(|v| v.y), z: column(|v| v.z) }
        };
        Self(vertices.chunks(LANES).map(group).collect())
    }

    /// Replaces the vertices by `rotation * (scale * v)` for each vertex `v` of `other`.
    pub(crate) fn turn(&mut self, other: &Self, scale: f64, rotation: &DMat3) {
        self.0.clear();
        self.0.extend(other.0.iter().map(|group| group.turned(scale, rotation)));
    }

    /// Vertex `i`.
    #[inline]
    pub(crate) fn vertex(&self, i: u32) -> DVec3 {
        let (group, lane) = (&self.0[i as usize / LANES], i as usize % LANES);
        DVec3::new(group.x[lane], group.y[lane], group.z[lane])
    }

    #[inline]
    pub(super) fn groups(&self) -> &[Group] {
        &self.0
    }

    pub(crate) fn heap_bytes(&self) -> usize {
        self.0.capacity() * size_of::<Group>()
    }
}

impl Group {
    #[inline]
    fn turned(&self, scale: f64, rotation: &DMat3) -> Self {
        let [x, y, z] = [self.x, self.y, self.z].map(|column| column.map(|c| c * scale));
        let [cx, cy, cz] = [rotation.x_axis, rotation.y_axis, rotation.z_axis];
        let row = |rx: f64, ry: f64, rz: f64| std::array::from_fn(|k| rx * x[k] + ry * y[k] + rz * z[k]);
        Self { x: row(cx.x, cy.x, cz.x), y: row(cx.y, cy.y, cz.y), z: row(cx.z, cy.z, cz.z) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a rotation of columns that differs in a bit from rotating the vertices one by one.
    #[test]
    fn turned_columns_are_the_turned_vertices() {
        let rotation = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(1.1);
        let vertices: Vec<DVec3> = (0..21).map(|i| DVec3::new(0.1, -0.7, 0.3) * f64::from(i)).collect();
        let mut turned = Columns::new(&[DVec3::ONE; 40]);
        turned.turn(&Columns::new(&vertices), 0.25, &rotation);
        for (i, v) in (0..).zip(&vertices) {
            assert_eq!(turned.vertex(i), rotation * (*v * 0.25));
        }
        assert_eq!(turned.0.len(), 3);
        assert_eq!(turned.vertex(23), turned.vertex(0));
    }
}
