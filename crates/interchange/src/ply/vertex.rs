//! One row of the element `vertex` in a PLY file of 3D Gaussian splatting, or of `sh` in a compressed one, as
//! `serde_ply` reads it. Files are binary of either byte order, or ASCII, with properties in any order. What does not
//! live here: the interpretation of the numbers.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};

/// Properties that every file has.
pub const REQUIRED: usize = 14;

/// Properties that are read: those that a file must have, then the harmonics of degree 1 and above.
#[rustfmt::skip]
pub const PROPERTIES: [&str; 59] = [
    "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
    "rot_0", "rot_1", "rot_2", "rot_3",
    "f_rest_0", "f_rest_1", "f_rest_2", "f_rest_3", "f_rest_4", "f_rest_5", "f_rest_6", "f_rest_7", "f_rest_8",
    "f_rest_9", "f_rest_10", "f_rest_11", "f_rest_12", "f_rest_13", "f_rest_14", "f_rest_15", "f_rest_16", "f_rest_17",
    "f_rest_18", "f_rest_19", "f_rest_20", "f_rest_21", "f_rest_22", "f_rest_23", "f_rest_24", "f_rest_25",
    "f_rest_26", "f_rest_27", "f_rest_28", "f_rest_29", "f_rest_30", "f_rest_31", "f_rest_32", "f_rest_33",
    "f_rest_34", "f_rest_35", "f_rest_36", "f_rest_37", "f_rest_38", "f_rest_39", "f_rest_40", "f_rest_41",
    "f_rest_42", "f_rest_43", "f_rest_44",
];

/// The values of `LEN` of [`PROPERTIES`] of one Gaussian, from `START` on. Other properties are ignored.
pub struct Vertex<const START: usize, const LEN: usize>(pub [f32; LEN]);

impl<'de, const START: usize, const LEN: usize> Deserialize<'de> for Vertex<START, LEN> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_struct("Vertex", &PROPERTIES[START..][..LEN], RowVisitor)
    }
}

struct RowVisitor<const START: usize, const LEN: usize>;

impl<'de, const START: usize, const LEN: usize> Visitor<'de> for RowVisitor<START, LEN> {
    type Value = Vertex<START, LEN>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the properties of one Gaussian")
    }

    /// For binary files without lists: `serde_ply` gives the values in the order of [`PROPERTIES`].
    fn visit_seq<A: SeqAccess<'de>>(self, mut row: A) -> Result<Vertex<START, LEN>, A::Error> {
        let mut values = [0.0; LEN];
        for (i, value) in values.iter_mut().enumerate() {
            *value = row.next_element()?.ok_or_else(|| Error::missing_field(PROPERTIES[START + i]))?;
        }
        Ok(Vertex(values))
    }

    /// For other files: name by name, in the file's order.
    fn visit_map<A: MapAccess<'de>>(self, mut row: A) -> Result<Vertex<START, LEN>, A::Error> {
        let mut values = [None; LEN];
        while let Some(Place(place)) = row.next_key::<Place<START, LEN>>()? {
            match place {
                Some(place) => values[place] = Some(row.next_value()?),
                None => _ = row.next_value::<IgnoredAny>()?,
            }
        }
        if let Some(missing) = values.iter().position(Option::is_none) {
            return Err(Error::missing_field(PROPERTIES[START + missing]));
        }
        Ok(Vertex(values.map(Option::unwrap_or_default)))
    }
}

/// Where the value of a property goes; none of a property that is ignored.
struct Place<const START: usize, const LEN: usize>(Option<usize>);

impl<'de, const START: usize, const LEN: usize> Deserialize<'de> for Place<START, LEN> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_identifier(NameVisitor)
    }
}

struct NameVisitor<const START: usize, const LEN: usize>;

impl<const START: usize, const LEN: usize> Visitor<'_> for NameVisitor<START, LEN> {
    type Value = Place<START, LEN>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a property")
    }

    fn visit_bytes<E: Error>(self, name: &[u8]) -> Result<Place<START, LEN>, E> {
        Ok(Place(PROPERTIES[START..][..LEN].iter().position(|property| property.as_bytes() == name)))
    }
}
