static void advance_cell(const double *restrict x, int inputs, int units,
                         const double *restrict input_weight,
                         const double *restrict recurrent_weight, const double *restrict bias,
                         double *restrict h, double *restrict c)
{
    double gate[4 * WIDEST];
    for (int u = 0; u < 4 * units; ++u) {
        gate[u] = bias[u];
    }
    for (int k = 0; k < inputs; ++k, input_weight += 4 * units) {
        for (int u = 0; u < 4 * units; ++u) {
            gate[u] += x[k] * input_weight[u];
        }
    }
    for (int k = 0; k < units; ++k, recurrent_weight += 4 * units) {
        for (int u = 0; u < 4 * units; ++u) {
            gate[u] += h[k] * recurrent_weight[u];
        }
    }
    for (int u = 0; u < units; ++u) {
        const double kept = c[u] / (1.0 + exp(-gate[units + u]));
        c[u] = kept + tanh(gate[2 * units + u]) / (1.0 + exp(-gate[u]));
        h[u] = tanh(c[u]) / (1.0 + exp(-gate[3 * units + u]));
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
            const double *V = weight + (size_t)g * inputs * 4 * U;
            const double *W = weight + (size_t)PARTS * inputs * 4 * U + (size_t)g * U * 4 * U;
            const double *b = weight + (size_t)PARTS * (inputs + U) * 4 * U + (size_t)g * 4 * U;
            double *h = own + 2 * g * U, *c = h + U;
            advance_cell(seen, inputs, U, V, W, b, h, c);
            memcpy(seen, h, (size_t)U * sizeof *seen);
            weight += (size_t)PARTS * (inputs + U + 1) * 4 * U;
            own += 2 * PARTS * U;
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
