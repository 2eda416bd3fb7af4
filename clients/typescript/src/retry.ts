import { Problem } from "./problem.js";

/** Longest pause between two attempts in milliseconds, unless the service asks for a longer one. */
const MAX_PAUSE = 15_000;

/** Milliseconds to wait: exponential with jitter, and at least the `Retry-After` of the service. */
export function pauseAfter(failures: number, problem: Problem): number {
  const steps = Math.min(250 * 2 ** Math.min(failures - 1, 8), MAX_PAUSE);
  return (problem.retryAfter ?? 0) * 1000 + steps * (0.5 + Math.random() / 2);
}

/** Waits. Rejects when the signal aborts. */
export function pause(milliseconds: number, signal?: AbortSignal): Promise<void> {
  return new Promise((resolve, reject) => {
    if (signal?.aborted) return reject(signal.reason);
    const stop = (): void => {
      clearTimeout(timer);
      reject(signal?.reason);
    };
    const timer = setTimeout(() => {
      signal?.removeEventListener("abort", stop);
      resolve();
    }, milliseconds);
    signal?.addEventListener("abort", stop, { once: true });
  });
}

export interface RetryOptions {
  /** Time in milliseconds for all attempts. When it is over, the last problem is thrown. */
  within: number;
  /** Whether the request may be sent twice. If not, it is sent again only after a response with status 429 or 503. */
  repeatable?: boolean;
  signal?: AbortSignal | undefined;
}

/** Calls `work` with the number of the attempt until it succeeds or fails with a permanent error. */
export async function retryWithBackoff<T>(work: (tries: number) => Promise<T>, { within, repeatable = true, signal }: RetryOptions): Promise<T> {
  const end = performance.now() + within;
  for (let tries = 1; ; tries += 1) {
    try {
      return await work(tries);
    } catch (error) {
      const again = error instanceof Problem && error.isTransient && (repeatable || error.status === 429 || error.status === 503);
      if (!again || signal?.aborted) throw error;
      const wait = pauseAfter(tries, error);
      if (performance.now() + wait > end) throw error;
      await pause(wait, signal);
    }
  }
}
