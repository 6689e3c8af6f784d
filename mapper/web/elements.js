// Elements of the page, made in one expression.

const VECTOR = "http://www.w3.org/2000/svg";

/** An HTML element; attributes that are null or false are left out, true is an empty one, functions are event listeners. */
export function make(name, attributes = {}, ...children) {
  return fill(document.createElement(name), attributes, children);
}

/** An element of SVG. */
export function draw(name, attributes = {}, ...children) {
  return fill(document.createElementNS(VECTOR, name), attributes, children);
}

/** Set text only where it differs: what is the same is not spoken again. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function fill(element, attributes, children) {
  for (const [key, value] of Object.entries(attributes)) {
    if (value === null || value === false || value === undefined) continue;
    if (typeof value === "function") element.addEventListener(key, value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}
