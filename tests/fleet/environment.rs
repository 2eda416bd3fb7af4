//! The environment: it starts, pauses, stops and kills processes, cuts connections, and moves the database's clock, as planned.

use std::rc::Rc;

use super::api::{self, Submission};
use super::executor::Millis;
use super::plan::{APIS, ENVIRONMENT, Event, WORKERS};
use super::worker;
use super::world::{Connection, World, name_of};

/// How long a stopping worker finishes its jobs before it releases them.
const PATIENCE: Millis = 2_000;
/// How long a stopping worker may take in total.
const STOP_TIME: Millis = 12_000;

/// Starts every process and schedules every event.
pub fn start(world: &Rc<World>) {
    for process in APIS.into_iter().chain(WORKERS) {
        start_process(world, process);
    }
    for event in world.plan.events.clone() {
        let at = match event {
            Event::Submit { at, .. } | Event::Cancel { at, .. } | Event::Partition { at, .. } => at,
            Event::Pause { at, .. } | Event::Kill { at, .. } | Event::Stop { at, .. } => at,
            Event::Restart { at, .. } | Event::Jump { at, .. } => at,
            Event::LoseReply { .. } | Event::Child { .. } | Event::Receiver { .. } | Event::Request { .. } => continue,
        };
        let world = Rc::clone(world);
        world.clone().sim.spawn(ENVIRONMENT, async move {
            world.sim.sleep(ENVIRONMENT, at).await;
            happen(world, event).await;
        });
    }
}

async fn happen(world: Rc<World>, event: Event) {
    if !matches!(event, Event::Submit { .. }) {
        world.note(|| format!("{event:?}"));
    }
    match event {
        Event::Submit { job, tenant, keyed, called_back, .. } => {
            api::submit(world, Submission { job, tenant, keyed, called_back }).await;
        }
        Event::Cancel { job, .. } => api::cancel(world, job).await,
        Event::Partition { process, ms, one_way, .. } => {
            let connection = &world.processes[process].connection;
            connection.set(if one_way { Connection::OneWay } else { Connection::Down });
            wait(&world, ms).await;
            connection.set(Connection::Up);
        }
        Event::Pause { process, ms, suspended, .. } => {
            world.sim.pause(process);
            wait(&world, ms).await;
            world.sim.resume(process, suspended);
        }
        Event::Kill { process, ms, .. } => kill(&world, process, ms),
        Event::Stop { process, ms, .. } => stop(&world, process, ms).await,
        Event::Restart { ms, crash, .. } => {
            world.is_database_up.set(false);
            if crash {
                world.crash();
            }
            wait(&world, ms).await;
            world.is_database_up.set(true);
        }
        Event::Jump { ms, .. } => world.clock_offset.set(world.clock_offset.get() + ms),
        Event::LoseReply { .. } | Event::Child { .. } | Event::Receiver { .. } | Event::Request { .. } => {}
    }
}

async fn wait(world: &World, time: Millis) {
    world.sim.sleep(ENVIRONMENT, time).await;
}

fn start_process(world: &Rc<World>, process: usize) {
    let state = &world.processes[process];
    if !state.is_up.replace(true) {
        state.starts.set(state.starts.get() + 1);
        if APIS.contains(&process) { api::start(world, process) } else { worker::start(world, process) }
    }
}

/// Kills a process, and starts it again after `down`.
pub fn kill(world: &Rc<World>, process: usize, down: Millis) {
    let world = Rc::clone(world);
    // Not at once: a process may kill itself, and its running task can't be dropped.
    world.clone().sim.spawn(ENVIRONMENT, async move {
        world.note(|| format!("{} is killed", name_of(process)));
        let state = &world.processes[process];
        state.is_up.set(false);
        world.sim.kill(process);
        state.changed.borrow_mut().clear();
        wait(&world, down).await;
        start_process(&world, process);
    });
}

/// Shuts a worker down, and starts it again after `down`.
async fn stop(world: &Rc<World>, process: usize, down: Millis) {
    let state = &world.processes[process];
    state.drain.borrow().set();
    wait(world, PATIENCE).await;
    state.now.borrow().set();
    wait(world, STOP_TIME - PATIENCE).await;
    kill(world, process, down - STOP_TIME);
}
