use super::operators::duplicates::remove_duplicates;
use super::operators::orient::{Nested, Orient};
use super::{Cancelled, Context, Options};
use crate::inspect::{Analysis, Measures};
use crate::mesh::Soup;

/// The faces of a closed input as [`Orient`] winds them, for measuring what it encloses: parts that are inside out would count against
/// the others. None where nothing is turned, or the input is open, so that its volume says nothing anyway, or where
/// the time was over.
///
/// # Errors
/// [`Cancelled`] when the job was canceled.
pub(super) fn settle_orientation(
    analysis: &Analysis<'_>,
    before: &Measures,
    options: &Options,
    context: &Context<'_>,
) -> Result<Option<Soup>, Cancelled> {
    let outward = before.consistent && before.inverted_parts == 0 && before.volume.value > 0.0;
    if !before.closed || (outward && options.nested == Nested::Keep) {
        return Ok(None);
    }
    let mut surface = analysis.surface.clone();
    // Faces that are there twice enclose nothing, and hide from each other what is around them.
    remove_duplicates(&mut surface);
    let oriented = Orient { nested: options.nested }.apply(&mut surface, &context.for_verification());
    if context.unless_late(oriented)?.is_none() {
        return Ok(None);
    }
    Ok((surface.faces != analysis.surface.faces).then(|| surface.to_soup()))
}

/// The structure of settled faces; none where there are none, or where the time was over.
///
/// # Errors
/// [`Cancelled`] when the job was canceled.
pub(super) fn analyse_settled<'a>(
    soup: Option<&'a Soup>,
    context: &Context<'_>,
) -> Result<Option<Analysis<'a>>, Cancelled> {
    let verification = context.for_verification();
    Ok(match soup {
        Some(soup) => context.unless_late(Analysis::new(soup.into(), &verification))?,
        None => None,
    })
}
