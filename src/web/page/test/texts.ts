/** All texts by their names, those of functions with numbers and words put in. */
export function texts(value: unknown, name = ""): [string, string][] {
  if (typeof value === "string") return [[name, value]];
  if (typeof value === "function") {
    // Texts take numbers and words, or figures by name.
    const figures = (n: number): object => ({ n: String(n), k: n, value: `${n} %`, limit: "3 %", amount: "2 mm", share: "4 %", unit: "mm" });
    const given = (n: number): unknown[] => (/^\(?\s*\{/.test(String(value)) ? [figures(n)] : [n, n, n]);
    return [1, 2].map((n) => [`${name}(${n})`, String((value as (...a: unknown[]) => string)(...given(n)))]);
  }
  return Object.entries(value as object).flatMap(([key, inner]) => texts(inner, `${name}.${key}`));
}
