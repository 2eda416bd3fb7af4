/*
 * The queue's protocol: claim, heartbeat, requeue, release, failure, completion and cancellation by several workers, with lost answers,
 * late and repeated requests, dead workers, expired leases and a crash of the database. See fleet.md for how to check it.
 *
 * Each statement of the database is atomic. Between statements anything may happen, so a pause of any length is covered.
 * Without one of the guards (-DNO_...), the check must fail.
 */
#ifndef WORKERS
#define WORKERS 3
#endif
#ifndef JOBS
#define JOBS 2
#endif
#ifndef MAX_CRASHES
#define MAX_CRASHES 3
#endif

mtype = { queued, running, succeeded, failed, canceled };
mtype = { none, heartbeat, complete, fail, release };

typedef Job {
    mtype status = queued;
    byte attempt;
    byte crashes;
    bool expired;       /* whether the lease has expired */
    bool unsynced;      /* whether the claim is not on the disk yet */
    byte ends;          /* how often the job ended */
    byte messages;      /* how many messages announce an end */
};

/*
 * What a worker knows of its claim, and what a request carries. Tokens are random: a claim has the token of the job's lease until that
 * lease ends, and never again. So a bit says whether it has.
 */
typedef Claim {
    bool valid;
    byte job;
    byte attempt;
    bool has_token;     /* whether its token is that of the job's lease */
    bool has_completed; /* whether a write with its token completed the job, so that its files are published */
};

Job job[JOBS];
Claim claim[WORKERS + 1];
/* A request that is still on its way carries the last one. */
#define LATE WORKERS
mtype late_kind = none;
bool database_crashed;

#define ended(j) (job[j].status == succeeded || job[j].status == failed || job[j].status == canceled)

#ifdef NO_TOKEN
#define same_token(c) true
#else
#define same_token(c) (claim[c].has_token)
#endif
#ifdef NO_FENCE
#define holds(c) (job[claim[c].job].status == running)
#else
#define holds(c) (job[claim[c].job].status == running && job[claim[c].job].attempt == claim[c].attempt && same_token(c))
#endif

inline forget(c) {
    claim[c].valid = false;
    claim[c].job = 0;
    claim[c].attempt = 0;
    claim[c].has_token = false;
    claim[c].has_completed = false
}

#define is_on(w, k) (w <= WORKERS && claim[w].valid && claim[w].job == k)

/*
 * The lease on job `k` ends, so no claim so far has its token from now on. Fewer states: a claim on an ended job can have no effect, so
 * it is forgotten, except that of the worker that completed the job.
 */
inline revoke(completes) {
    w = 0;
    do
    :: w > WORKERS -> break
    :: is_on(w, k) && ended(k) && !(completes && claim[w].has_token) ->
        forget(w);
        if
        :: w == LATE -> late_kind = none
        :: else
        fi;
        w++
    :: is_on(w, k) && !(ended(k) && !(completes && claim[w].has_token)) ->
        claim[w].has_completed = completes;
        claim[w].has_token = false;
        w++
    :: w <= WORKERS && !is_on(w, k) -> w++
    od;
    w = 0
}

/* Takes the lease on job `k` away, in a commit that waits for the disk, and with it for all before. */
inline drop_lease(completes) {
    revoke(completes);
    job[k].expired = false;
    job[0].unsynced = false;
    job[1].unsynced = false;
    k = 0
}

/* Ends job `k`, and writes its message in the same transaction. */
inline end_job(end_status) {
    job[k].status = end_status;
    job[k].attempt = 0;     /* fewer states: nothing reads these any more */
    job[k].crashes = 0;
    job[k].ends++;
#ifdef NO_OUTBOX
    if
    :: job[k].messages++
    :: skip
    fi
#else
    job[k].messages++
#endif
}

inline requeue_or_fail() {
    job[k].crashes++;
    if
    :: job[k].crashes >= MAX_CRASHES -> end_job(failed)
    :: else -> job[k].status = queued
    fi
}

/* Executes a write under claim `c`. Sets `ok` to the answer: true for done, false for `LeaseLost`. */
inline execute(kind, c) {
    k = claim[c].job;
    if
    :: holds(c) ->
        assert(claim[c].has_token);                    /* no stale write lands */
        ok = true;
        if
        :: kind == heartbeat -> job[k].expired = false; k = 0
        :: kind == complete -> end_job(succeeded); drop_lease(true)
        :: kind == fail -> requeue_or_fail(); drop_lease(false)
        :: kind == release -> job[k].status = queued; job[k].attempt--; drop_lease(false)
        fi
    :: else ->
#ifdef NO_REPEAT
        ok = false;
#else
        ok = (kind != heartbeat) && claim[c].has_completed;
#endif
        /* A worker that is told that its lease is lost deletes its files. */
        assert(ok || c == LATE || kind == heartbeat || !claim[c].has_completed);
        k = 0
    fi
}

inline send_late(kind) {
    late_kind = kind;
    claim[LATE].valid = true;
    claim[LATE].job = claim[me].job;
    claim[LATE].attempt = claim[me].attempt;
    claim[LATE].has_token = claim[me].has_token;
    claim[LATE].has_completed = claim[me].has_completed
}

inline do_claim(j) {
    job[j].status = running;
    job[j].attempt++;
    job[j].unsynced = true;
    if
    :: claim[me].valid = true; claim[me].job = j; claim[me].attempt = job[j].attempt; claim[me].has_token = true
    :: true                                     /* the answer is lost */
    fi
}

#ifdef NO_ATOMIC_CLAIM
#define claimable(j) (seen == j + 1 && !ended(j))
#else
#define claimable(j) (job[j].status == queued)
#endif

/* Idle workers are alike, so only the first one claims. */
#define is_first (me == 0 || (claim[0].valid && (me == 1 || claim[1].valid)))
#define all_ended (ended(0) && ended(1))
#define busy (claim[me].valid && !all_ended)

/* A worker with a claim may make its requests in any order and repeat them, which is more than the real one does. */
active [WORKERS] proctype worker() {
    byte me = _pid;
    byte w, k;
    bool ok;
#ifdef NO_ATOMIC_CLAIM
    byte seen;
#endif

end_idle:
    do
#ifdef NO_ATOMIC_CLAIM
    :: atomic { !claim[me].valid && seen == 0 && job[0].status == queued -> seen = 1 }
    :: atomic { !claim[me].valid && seen == 0 && job[1].status == queued -> seen = 2 }
    :: atomic { !claim[me].valid && seen > 0 && ended(seen - 1) -> seen = 0 }
    :: atomic { !claim[me].valid && claimable(0) -> seen = 0; assert(job[0].status == queued); do_claim(0) }
    :: atomic { !claim[me].valid && claimable(1) -> seen = 0; assert(job[1].status == queued); do_claim(1) }
#else
    :: atomic { !claim[me].valid && is_first && claimable(0) -> do_claim(0) }
    :: atomic { !claim[me].valid && is_first && claimable(1) -> do_claim(1) }
#endif
    /* A request takes effect. Either the worker gets the answer and goes on or stops, or the answer is lost and it may try again. */
    :: atomic { busy ->
        execute(heartbeat, me);
        if
        :: !ok -> forget(me)
        :: true
        fi;
        ok = false
    }
    :: atomic { busy ->
        if
        :: execute(complete, me)
        :: execute(fail, me)
        :: execute(release, me)
        fi;
        ok = false;
        if
        :: forget(me)
        :: true
        fi
    }
    /* A request is on its way for long. The worker gives up waiting for the answer. */
    :: atomic { busy && late_kind == none ->
        if
        :: send_late(heartbeat)
        :: send_late(complete)
        :: send_late(fail)
        :: send_late(release)
        fi
    }
    /* The worker dies, or gives up, and starts again. */
    :: atomic { busy -> forget(me) }
    od
}

#ifdef NO_LEASE_CHECK
#define may_requeue(j) (job[j].status == running)
#else
#define may_requeue(j) (job[j].status == running && job[j].expired)
#endif

/* Time, the network, clients, and the database's machine. */
active proctype environment() {
    byte w, k;
    bool ok;

    do
    /* A lease expires. */
    :: atomic { job[0].status == running && !job[0].expired -> job[0].expired = true }
    :: atomic { job[1].status == running && !job[1].expired -> job[1].expired = true }
    /* Any process requeues the job. */
    :: atomic { may_requeue(0) -> k = 0; assert(job[k].expired); requeue_or_fail(); drop_lease(false) }
    :: atomic { may_requeue(1) -> k = 1; assert(job[k].expired); requeue_or_fail(); drop_lease(false) }
    /* A client cancels a job. */
    :: atomic { !ended(0) -> k = 0; end_job(canceled); drop_lease(false) }
    :: atomic { !ended(1) -> k = 1; end_job(canceled); drop_lease(false) }
    /* A late request arrives. */
    :: atomic { late_kind != none && !all_ended -> execute(late_kind, LATE); late_kind = none; forget(LATE); ok = false }
    /* The database crashes, and loses the claims that are not on the disk. */
    :: atomic { !database_crashed && (job[0].unsynced || job[1].unsynced) ->
        database_crashed = true;
        k = 0;
        do
        :: k < JOBS && job[k].unsynced ->
            revoke(false);
            job[k].status = queued;
            job[k].attempt--;
            job[k].expired = false;
            job[k].unsynced = false;
            k++
        :: k < JOBS && !job[k].unsynced -> k++
        :: else -> break
        od;
        k = 0
    }
    :: timeout -> assert(all_ended); break     /* every job can end */
    od
}

/* A job ends at most once, and each end has its message. */
active proctype monitor() {
end_watch:
    do
    :: atomic { job[0].ends > 1 || job[1].ends > 1 -> assert(false) }
    :: atomic { job[0].messages != job[0].ends || job[1].messages != job[1].ends -> assert(false) }
    od
}
