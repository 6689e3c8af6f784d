// What the page says by itself: a line that can be seen and closed, and regions that screen readers speak.

const element = (id) => document.getElementById(id);

/** Speak through a screen reader; what is urgent interrupts. */
export function say(text, { isUrgent = false } = {}) {
  const region = element(isUrgent ? "said-urgently" : "said");
  // The same words again are a change only if they were gone meanwhile.
  region.textContent = "";
  requestAnimationFrame(() => {
    region.textContent = text;
  });
}

/** Show a line until it is closed or another one comes; isFine null: neither good nor bad. */
export function tell(text, isFine = null) {
  const line = element("message");
  element("message-text").textContent = text;
  line.className = `message ${isFine === null ? "" : isFine ? "good" : "bad"}`;
  line.hidden = false;
}

export function startMessages() {
  element("message-close").addEventListener("click", () => {
    element("message").hidden = true;
  });
}
