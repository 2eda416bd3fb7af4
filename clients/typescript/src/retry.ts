import { Problem } from "./problem.js";

/** Longest pause between two tries that nobody asked for, in milliseconds. */
const LONGEST_PAUSE = 15_000;

/** Milliseconds to wait after so many failures: longer each time and never the same, and no less than the service asked for. */
export function pauseAfter(failures: number, problem: Problem): number {
  const steps = Math.min(250 * 2 ** Math.min(failures - 1, 8), LONGEST_PAUSE);
  return (problem.retryAfter ?? 0) * 1000 + steps * (0.5 + Math.random() / 2);
}

/** Waits, unless the signal says stop. */
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

export interface Patience {
  /** Milliseconds for all tries; the last problem is thrown where they are over. */
  within: number;
  /** Whether what is sent twice does no harm; without it only what was refused is sent again. */
  repeatable?: boolean;
  signal?: AbortSignal | undefined;
}

/** Does it again while what stops it may pass. */
export async function patiently<T>(work: (tries: number) => Promise<T>, { within, repeatable = true, signal }: Patience): Promise<T> {
  const end = performance.now() + within;
  for (let tries = 1; ; tries += 1) {
    try {
      return await work(tries);
    } catch (error) {
      const again = error instanceof Problem && error.isPassing && (repeatable || error.status === 429 || error.status === 503);
      if (!again || signal?.aborted) throw error;
      const wait = pauseAfter(tries, error);
      if (performance.now() + wait > end) throw error;
      await pause(wait, signal);
    }
  }
}
