// Brings rows into another order by as few moves as will do, and not all of them in one frame: a row that is moved is laid out anew.

const MOVES_A_STEP = 10;

/** A generator that moves the children of `body`; between two steps somebody may look at the page. The rows at the top come first. */
export function* reorder(body, elements) {
  const places = new Map([...body.children].map((element, place) => [element, place]));
  const stays = increasing(elements.map((element) => places.get(element)));
  let before = null, nMoves = 0;
  for (let i = 0; i < elements.length; i += 1) {
    if (!stays.has(i)) {
      if (nMoves > 0 && nMoves % MOVES_A_STEP === 0) yield;
      nMoves += 1;
      body.insertBefore(elements[i], before === null ? body.firstElementChild : before.nextElementSibling);
    }
    before = elements[i];
  }
}

/** Places in a list of different numbers whose numbers grow: as many as there can be. A set. */
export function increasing(numbers) {
  // Of runs of each length, the place where the one with the smallest end ends; and before each place, which one comes in its run.
  const ends = [], earlier = [];
  numbers.forEach((number, place) => {
    let low = 0, high = ends.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (numbers[ends[middle]] < number) low = middle + 1;
      else high = middle;
    }
    earlier.push(low > 0 ? ends[low - 1] : null);
    ends[low] = place;
  });
  const found = new Set();
  for (let place = ends.at(-1) ?? null; place !== null; place = earlier[place]) found.add(place);
  return found;
}
