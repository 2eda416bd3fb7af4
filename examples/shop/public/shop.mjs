// The shop's page. It asks its backend for prices and orders, and calculates no price itself.
const widget = document.querySelector("meshmend-upload");
const offer = document.getElementById("offer");
const button = document.getElementById("order");
const euros = new Intl.NumberFormat("en-IE", { style: "currency", currency: "EUR" });
let quote = null;
/** Counts what was said, so that a late price does not replace what was said after its request. */
let said = 0;

function say(text, quoted = null) {
  said += 1;
  offer.textContent = text;
  quote = quoted;
  button.disabled = quoted === null;
}

async function ask(path, body) {
  const init = body && { method: "POST", headers: { "content-type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(path, init);
  const result = await answer.json();
  if (!answer.ok) throw new Error(result.message);
  return result;
}

widget.addEventListener("uploaded", () => say("Your model is being checked."));
widget.addEventListener("failed", ({ detail }) => say(detail.code === "canceled" ? "Upload a model to see its price." : detail.message));
widget.addEventListener("repaired", ({ detail }) => offerResult(detail.jobId, detail.metrics.printable));
widget.addEventListener("chosen", ({ detail }) => offerResult(detail.jobId, detail.printable, detail.choice));

/** Shows the price of a job's result, unless something else was said meanwhile. Until then nothing can be ordered. */
async function offerResult(jobId, printable, choice = "default") {
  if (!printable) return say("This model can't be printed yet. The upload says what you can do.");
  say("Your price is being calculated.");
  const asked = said;
  const answer = (text, quoted) => said === asked && say(text, quoted);
  try {
    const made = await ask("/quotes", { jobId, choice });
    const price = `${made.volumeCm3.toFixed(1)} cm³ cost ${euros.format(made.cents / 100)}.`;
    answer([price, ...made.assumptions.map((it) => `Assumed: ${it}`)].join("\n"), made.id);
  } catch (error) {
    answer(error.message);
  }
}

button.addEventListener("click", async () => {
  try {
    let order = await ask("/orders", { quoteId: quote });
    say("Thank you. Your order was received.");
    while (order.status === "received") {
      await new Promise((resolve) => setTimeout(resolve, 1000));
      order = await ask(`/orders/${order.id}`);
    }
    say(`Thank you. Your order is ${order.status}.`);
  } catch (error) {
    say(error.message);
  }
});
