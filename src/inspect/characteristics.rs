use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Analysis, Attributes, Elements, Level, Measures, Shells, Statistics, shells, statistics};
use crate::context::{Cancelled, Context};

/// What meshalyzer reports of a mesh (seed 004) beyond [`Measures`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Characteristics {
    /// The four attributes.
    pub attributes: Attributes,
    /// What the file itself says of its vertices and faces.
    pub elements: Elements,
    /// The edge-connected parts.
    pub shells: Shells,
    /// How faces and edges are shaped; none at level `none`.
    pub statistics: Option<Statistics>,
}

/// Finds the characteristics of a mesh that was measured.
///
/// # Errors
/// [`Cancelled`] when the work should stop.
pub fn characteristics(
    analysis: &Analysis<'_>,
    measures: &Measures,
    level: Level,
    context: &Context<'_>,
) -> Result<Characteristics, Cancelled> {
    let (shells, turning) = shells(analysis, context)?;
    let attributes = Attributes::new(measures, &turning);
    let statistics = match level {
        Level::None => None,
        Level::Basic | Level::Full => Some(statistics(analysis, &attributes, &turning, context)?),
    };
    Ok(Characteristics { attributes, elements: Elements::new(analysis, measures), shells, statistics })
}
