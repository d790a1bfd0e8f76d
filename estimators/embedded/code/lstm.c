static void advance_cell(const double *restrict x, int inputs, int units,
                         const double *restrict input_weight,
                         const double *restrict recurrent_weight, const double *restrict bias,
                         double *restrict h, double *restrict c)
{
    double gate[4 * WIDEST] = {0.0};
    const int candidate = 4 * units - GATES * units; /* that of a GRU's memory stands alone */
    for (int u = 0; u < GATES * units; ++u) {
        gate[u] = bias[u];
    }
    for (int k = 0; k < inputs; ++k, input_weight += GATES * units) {
        for (int u = 0; u < GATES * units; ++u) {
            gate[u] += x[k] * input_weight[u];
        }
    }
    for (int k = 0; k < units; ++k, recurrent_weight += GATES * units) {
        for (int u = 0; u < GATES * units; ++u) {
            gate[u + (u < 2 * units ? 0 : candidate)] += h[k] * recurrent_weight[u];
        }
    }
    for (int u = 0; u < units; ++u) {
#if GATES == 4
        const double kept = c[u] / (1.0 + exp(-gate[units + u]));
        c[u] = kept + tanh(gate[2 * units + u]) / (1.0 + exp(-gate[u]));
        h[u] = tanh(c[u]) / (1.0 + exp(-gate[3 * units + u]));
#else
        const double reset = 1.0 / (1.0 + exp(-gate[u])), kept = 1.0 / (1.0 + exp(-gate[units + u]));
        const double next = tanh(gate[2 * units + u] + reset * gate[3 * units + u]);
        h[u] = next + kept * (h[u] - next);
        (void)c;
#endif
    }
}

/* Memory: which of the interleaved memories is next, and each of them: h and c of all cells. */
static void run_network(double *memory, const double x[INPUTS], double y[N])
{
    double *cell = memory + 1 + (size_t)memory[0] * CELLS;
    memory[0] = memory[0] + 1.0 < STRIDE ? memory[0] + 1.0 : 0.0;
    for (int g = 0; g < PARTS; ++g) {
        double seen[WIDEST], *own = cell;
        const double *weight = cell_weight;
        int inputs = PART_INPUTS;
        for (int k = 0; k < PART_INPUTS; ++k) {
            seen[k] = x[part_input[g][k]];
        }
        for (int layer = 0; layer < LAYERS; ++layer) {
            const int U = units[layer];
            const size_t gates = (size_t)GATES * U;
            const double *V = weight + g * inputs * gates;
            const double *W = weight + PARTS * inputs * gates + g * U * gates;
            const double *b = weight + PARTS * (inputs + U) * gates + g * gates;
            double *h = own + STATES * g * U, *c = h + (STATES - 1) * U;
            advance_cell(seen, inputs, U, V, W, b, h, c);
            memcpy(seen, h, (size_t)U * sizeof *seen);
            weight += PARTS * (inputs + U + 1) * gates;
            own += STATES * PARTS * U;
            inputs = U;
        }
#if HAS_LAYER
        for (int i = 0; i < PART_OUTPUTS; ++i) {
            double total = output_bias[g][i];
            for (int u = 0; u < inputs; ++u) {
                total += seen[u] * output_weight[g][u][i];
            }
            y[g * PART_OUTPUTS + i] = total;
        }
#else
        memcpy(y + g * PART_OUTPUTS, seen, PART_OUTPUTS * sizeof *y);
#endif
    }
}
