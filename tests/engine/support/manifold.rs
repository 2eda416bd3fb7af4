//! Arrangements by the crate manifold-rust, to compare ours with.

use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use glam::DVec3;
use manifold_rust::cancel::CancelToken;
use manifold_rust::manifold::Manifold;
use manifold_rust::types::{Error, MeshGL64, WindingRule as PeerRule};

use meshmend::arrange::{ArrangeError, Arrangement, MeetingFaces, Rule, Solid, WindingRule};
use meshmend::context::Context;
use meshmend::mesh::{ClosedSurface, NO_SOURCE, NotClosed, Soup, Surface};

/// The interval between checks for cancellation.
const LOOK: Duration = Duration::from_millis(5);
/// Stack size of the worker thread.
const STACK: usize = 64 << 20;

/// The crate manifold-rust: a port of Manifold with a separate engine for self-intersecting surfaces.
#[derive(Debug, Clone, Copy, Default)]
pub struct ManifoldRust;

impl Arrangement for ManifoldRust {
    fn solid(
        &self,
        surface: ClosedSurface<'_>,
        _known: Option<&[MeetingFaces]>,
        rule: Rule,
        context: &Context<'_>,
    ) -> Result<Solid, ArrangeError> {
        let token = CancelToken::new();
        let mesh = to_mesh(&surface);
        let rule = match rule.winding_rule {
            WindingRule::Positive => PeerRule::Positive,
            WindingRule::Nonzero => PeerRule::Nonzero,
            WindingRule::Odd => return Err(ArrangeError::Failed("the engine knows no odd rule".to_owned())),
        };
        let (send, receive) = channel();
        let watched = token.clone();
        // The engine runs in another thread, since the context cannot leave this one, which checks for cancellation. A
        // panic of the engine also stays in that thread.
        let worker = std::thread::Builder::new().stack_size(STACK).spawn(move || {
            let solid = Manifold::from_mesh_gl64_robust(&mesh).rebuild_solid_with_token(rule, Some(&watched));
            let status = solid.status();
            let _ = send.send((status, solid.get_mesh_gl64(0)));
        });
        let worker = worker.map_err(|error| ArrangeError::Failed(error.to_string()))?;
        let mut stopped = None;
        let answer = loop {
            match receive.recv_timeout(LOOK) {
                Ok(answer) => break Some(answer),
                Err(RecvTimeoutError::Disconnected) => break None,
                Err(RecvTimeoutError::Timeout) => {
                    if let Err(stop) = context.check() {
                        stopped = Some(stop);
                        token.cancel();
                    }
                }
            }
        };
        let _ = worker.join();
        if let Some(stop) = stopped {
            return Err(stop.into());
        }
        match answer {
            None => Err(ArrangeError::Failed("the engine gave up".to_owned())),
            Some((Error::NotClosed | Error::NotManifold, _)) => Err(NotClosed.into()),
            Some((Error::NoError, mesh)) if mesh.tri_verts.is_empty() => Err(ArrangeError::Empty),
            Some((Error::NoError, mesh)) => Ok(Solid { surface: from_mesh(&mesh, &surface), ..Solid::default() }),
            Some((error, _)) => Err(ArrangeError::Failed(error.to_str().to_owned())),
        }
    }
}

fn to_mesh(surface: &Surface) -> MeshGL64 {
    MeshGL64 {
        num_prop: 3,
        vert_properties: surface.positions.iter().flat_map(|p| p.to_array()).collect(),
        tri_verts: surface.faces.iter().flatten().map(|&v| u64::from(v)).collect(),
        face_id: (0..surface.faces.len() as u64).collect(),
        ..MeshGL64::default()
    }
}

/// The result with vertices merged at equal positions.
fn from_mesh(mesh: &MeshGL64, from: &Surface) -> Surface {
    let stride = usize::try_from(mesh.num_prop).unwrap_or(3).max(3);
    let positions = mesh.vert_properties.chunks_exact(stride).map(|p| DVec3::new(p[0], p[1], p[2])).collect();
    #[expect(clippy::cast_possible_truncation, reason = "the engine counts vertices in u32")]
    let faces = mesh.tri_verts.chunks_exact(3).map(|t| [t[0] as u32, t[1] as u32, t[2] as u32]).collect();
    let (mut surface, _) = Surface::from_soup(&Soup { positions, faces });
    for source in &mut surface.source {
        let id = mesh.face_id.get(*source as usize).and_then(|&id| usize::try_from(id).ok());
        *source = id.and_then(|id| from.source.get(id)).copied().unwrap_or(NO_SOURCE);
    }
    surface
}
