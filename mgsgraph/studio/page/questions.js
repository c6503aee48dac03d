// Questions to the posterior: a point, two points, a place in an image, a line of an image, a new intersection; and what
// to measure next, which the map then shows. Examples with names of this block stand as buttons.

import {button, caption, make, refill, remover, short, table} from './plot.js';

// Height of the second of two points above the first, in a line
export async function difference(app, first, second) {
  const [{record}] = await app.request('/api/questions', {pairs: [[first, second]]});
  return heightLine(record);
}

function heightLine({points: [first, second], height_difference_m: height, height_sigma_m: sigma, height_sigma_if_independent_m: apart}) {
  return `Height of ${second} above ${first}: ${short(height)} m, sigma ${short(sigma)} m `
    + `(ratio ${short(Math.abs(height) / sigma, 2)}; sigma without their correlation ${short(apart)} m).`;
}

class Questions {
  constructor(app, element) {
    Object.assign(this, {app, element, pixels: []});
    this.answers = make('div', {className: 'answers'});
    this.points = make('input', {type: 'text', size: 30, placeholder: 'a point, or two: A, B', ariaLabel: 'Points'});
    this.image = make('select');
    this.line = make('input', {type: 'number', step: 'any', placeholder: 'line'});
    this.sample = make('input', {type: 'number', step: 'any', placeholder: 'sample'});
    this.list = make('ul');
    this.examples = make('div', {className: 'tools examples'});
    // Enter asks the first question of a row
    const row = (title, ...parts) => {
      parts.find(one => one.tagName === 'BUTTON').type = 'submit';
      return make('form', {onsubmit: event => event.preventDefault()}, make('fieldset', {}, make('legend', {textContent: title}), ...parts));
    };
    element.replaceChildren(
      make('div', {className: 'tools'},
        row('Ground points', this.points, button('How well known?', () => this.askPoints()), button('Is the height difference real?', () => this.askPair())),
        row('Next', this.planning = button('What should I measure next?', () => this.plan())),
        row('Position in an image', make('label', {}, 'image ', this.image), make('label', {}, 'line ', this.line), make('label', {}, 'sample ', this.sample),
          button('Orientation at this line', () => this.askPose()),
          button('Where is the selected point?', () => this.askProjection()),
          button('Add as a ray', () => this.add()), button('Intersect the rays', () => this.ask({pixels: this.pixels})))),
      this.examples, this.list, this.answers);
    app.hear(element, ['renewed'], () => this.offer());
    app.addEventListener('selected', () => this.take());
    app.addEventListener('placed', () => this.takePlace());
    this.offer();
    this.take();
    this.takePlace();
  }

  // Questions about this block, asked by a click
  async offer() {
    const {app} = this, {images, adjusted} = app.scene, [image] = images;
    refill(this.image, images.map(one => [one.name]));
    const {examples: [a, b], reasons} = await app.request('/api/worst').catch(() => ({examples: [], reasons: {}}));
    const line = image && Math.round(image.lines / 2);
    const questions = Object.entries({
      ...(b && {
        [`How well is ${a} known?`]: {points: [a]}, [`How much higher is ${b} than ${a}?`]: {pairs: [[a, b]]},
        [`Where is ${a} in ${image.name}?`]: {projections: [[a, image.name]]},
      }),
      ...(image && adjusted && {[`Orientation of ${image.name} at line ${line}?`]: {poses: [[image.name, line]]}}),
    });
    this.examples.replaceChildren(caption(questions.length ? 'Examples:' : 'Answers come from the covariances of an adjustment; nothing is adjusted yet.'),
      ...questions.map(([words, body]) => button(words, () => this.ask(body))));
    if (reasons.plan) this.examples.append(caption(`What should I measure next? ${reasons.plan}`));
    Object.assign(this.planning, {disabled: Boolean(reasons.plan), title: reasons.plan || 'Where one more tie point would help most'});
  }

  // The last selected points stand in the field: two of them for a difference
  take() {
    const {before, selection} = this.app, [last] = this.names().slice(-1), first = last || before;
    if (selection) this.points.value = first && first !== selection ? `${first}, ${selection}` : selection;
  }

  // The place of an image that was clicked last
  takePlace() {
    if (!this.app.placed) return;
    const {image, line, sample} = this.app.placed;
    [this.image.value, this.line.value, this.sample.value] = [image, line.toFixed(2), sample.toFixed(2)];
  }

  names() {
    return this.points.value.split(',').map(one => one.trim()).filter(Boolean);
  }

  number(input) {
    return input.value === '' ? NaN : Number(input.value);
  }

  askPoints() {
    if (!this.names().length) return this.app.say('Name a point (or select one on the map).', 'error');
    return this.ask({points: this.names(), correlations: this.names().length > 1});
  }

  askPair() {
    const names = this.names();
    if (names.length !== 2) return this.app.say('Name two points, with a comma between them (or select two on the map).', 'error');
    return this.ask({pairs: [names]});
  }

  askPose() {
    if (Number.isNaN(this.number(this.line))) return this.app.say('Give the line.', 'error');
    return this.ask({poses: [[this.image.value, this.number(this.line)]]});
  }

  askProjection() {
    const {app} = this;
    return app.selection ? this.ask({projections: [[app.selection, this.image.value]]}) : app.say('Select a point first.', 'error');
  }

  add() {
    const place = {image: this.image.value, line: this.number(this.line), sample: this.number(this.sample)};
    if (Number.isNaN(place.line) || Number.isNaN(place.sample)) return this.app.say('Give line and sample of the position.', 'error');
    this.pixels.push(place);
    return this.listRays();
  }

  listRays() {
    const away = one => () => { this.pixels.splice(this.pixels.indexOf(one), 1); this.listRays(); };
    this.list.replaceChildren(...this.pixels.map(one => make('li', {}, `${one.image}: line ${one.line}, sample ${one.sample} `,
      remover(`Remove the ray of ${one.image}`, away(one)))));
  }

  async ask(body) {
    const found = await this.app.orSay(this.app.request('/api/questions', body));
    if (!found) return;
    this.answers.prepend(...found.map(({text, record}) => make('section', {className: 'answer'},
      record.question === 'pair' ? make('strong', {textContent: heightLine(record)}) : '', make('pre', {textContent: text}))));
    this.app.say('');
  }

  async plan() {
    const {app} = this, places = one => one.images.map(({image, line, sample}) => `${image} (${line.toFixed(0)}, ${sample.toFixed(0)})`).join('; ');
    const see = (one, most) => app.show('images').then(view => view.see(one.images, '', most));
    app.say('Positions are compared …');
    const found = await app.orSay(app.request('/api/plan'));
    if (!found) return;
    const {sentence, candidates} = found;
    const columns = ['', 'longitude (° E)', 'latitude (°)', 'height (m)', 'images (line, sample)', 'mean sigma then (m)', 'gain (%)', ''];
    const best = table('What to measure next', columns, candidates.map((one, k) => [
      k + 1, one.longitude_deg.toFixed(5), short(one.latitude_deg, 7), short(one.height_m, 4), places(one), short(one.mean_sigma_m, 5), short(one.gain_percent, 2),
      [button('Images', () => see(one)), ' ', button('Measure', () => see(one, 4).then(view => view.measuring.open()))],
    ]), 'No further point would lower it.');
    best.append(caption(candidates[0]?.gain_percent < 0.1 ? `${sentence} Each gains less than 0.1 %.` : sentence), button('Show them on the map', () => app.show('map')));
    this.answers.prepend(best);
    app.candidates = candidates;
    app.emit('candidates');
    app.say('The map marks them by squares with numbers.');
  }
}

export {Questions as Panel};
