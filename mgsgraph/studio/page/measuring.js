// Measuring a point by hand: its name, a click in each image, least-squares refinement where the server offers it.

import {button, caption, check, form, make, remover, short} from './plot.js';

export class Measuring {
  constructor(app, images, place) {
    Object.assign(this, {app, images, place, running: false, places: new Map(), refining: true});
  }

  // [line, sample] measured in an image
  placeIn(name) {
    return this.running ? this.places.get(name)?.at : undefined;
  }

  open() {
    if (this.running) return this.name.focus();
    if (this.app.refusal) return this.app.say(this.app.refusal, 'error');
    this.running = true;
    this.places.clear();
    this.name = make('input', {type: 'text', value: this.freeName(), maxLength: 200});
    this.list = make('ul', {className: 'measured-places'});
    this.sentence = caption('');
    this.storing = make('button', {type: 'submit', textContent: 'Store', disabled: true});
    this.place.replaceChildren(form('measuring', 'Measure a point', () => this.store(), () => this.close(), make('label', {}, 'Point ', this.name),
      check('Refine by least squares', this.refining, on => { this.refining = on; }), this.list, this.storing, button('Cancel', () => this.close()), this.sentence));
    this.show();
    this.name.focus();
    this.name.select();
  }

  // A name that no tie of these images has
  freeName() {
    const taken = new Set(this.images.panes.flatMap(one => one.image?.ties.names || []));
    let k = 1;
    while (taken.has(`hand-${k}`)) k += 1;
    return `hand-${k}`;
  }

  close() {
    this.running = false;
    this.place.replaceChildren();
    this.images.request();
    this.images.frame?.canvas.focus();
  }

  // The place clicked in an image; from the second image on it is refined against the first
  async take(pane, at) {
    const {lines, samples} = pane.image;
    if (at[0] < 0 || at[1] < 0 || at[0] > lines || at[1] > samples)
      return this.app.say(`${pane.name}: this position is outside the image.`, 'error');
    this.places.set(pane.name, {at, words: 'by hand'});
    this.show();
    if (pane === this.images.frame) this.images.centerOn(pane, at); // the others then show its ground, not that beside it
    const [first] = this.places.keys();
    if (this.refining && first !== pane.name && pane.layer) await this.refined(first, pane.name, at);
  }

  async refined(first, name, at) {
    const [line, sample] = this.places.get(first).at;
    try {
      const found = await this.app.request('/api/refine', {
        reference: {image: first, line, sample}, image: name, line: at[0], sample: at[1],
      });
      if (this.places.get(name)?.at !== at) return;
      this.places.set(name, {
        at: [found.line, found.sample],
        words: `least squares, sigma ${short(found.sigma_px, 2)} px, correlation ${short(found.correlation, 2)}`,
        sigma: found.sigma_px,
      });
    } catch (error) {
      if (this.places.get(name)?.at !== at) return;
      this.places.set(name, {at, words: `by hand; ${error.message}`});
    }
    this.show();
  }

  show() {
    const items = [...this.places].map(([name, one]) => {
      const away = remover(`Remove the position in ${name}`, () => this.places.delete(name) && this.show());
      return make('li', {}, `${name}: line ${one.at[0].toFixed(2)}, sample ${one.at[1].toFixed(2)} (${one.words}) `, away);
    });
    this.list.replaceChildren(...items);
    this.storing.disabled = !this.places.size;
    this.sentence.textContent = this.places.size
      ? 'Store: one change, which can be undone.'
      : 'Click the point in each image, or bring it under the cross and press Enter.';
    this.images.request();
  }

  async store() {
    const point = this.name.value.trim();
    if (!point) return this.app.say('The point needs a name.', 'error');
    const measures = [...this.places].map(([image, {at, sigma}]) => ({
      image, line: at[0], sample: at[1], ...(sigma ? {sigma_px: sigma} : {}),
    }));
    this.storing.disabled = true;
    try {
      await this.app.change({kind: 'measure', point, measures});
      this.close();
      this.app.select(point);
    } catch (error) {
      this.app.say(error.message, 'error');
      this.storing.disabled = false;
    }
  }
}
