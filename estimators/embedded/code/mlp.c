/* Memory, of an LRU: which of the interleaved memories is next, and each of them: all states. */
static void run_network(double *memory, const double x[INPUTS], double y[N])
{
#if STATES
    double *state = memory + 1 + (size_t)memory[0] * PARTS * 2 * STATES;
    memory[0] = memory[0] + 1.0 < STRIDE ? memory[0] + 1.0 : 0.0;
#else
    (void)memory;
#endif
    for (int g = 0; g < PARTS; ++g) {
        double seen[READ], hidden[HIDDEN];
        for (int k = 0; k < PART_INPUTS; ++k) {
            seen[k] = x[part_input[g][k]];
        }
#if STATES
        double *z = state + g * 2 * STATES, *next = seen + PART_INPUTS;
        for (int s = 0; s < STATES; ++s) {
            const double real = transition[g][0][s], imaginary = transition[g][1][s];
            next[s] = real * z[s] - imaginary * z[STATES + s];
            next[STATES + s] = real * z[STATES + s] + imaginary * z[s];
        }
        for (int k = 0; k < PART_INPUTS; ++k) {
            for (int s = 0; s < 2 * STATES; ++s) {
                next[s] += seen[k] * input_weight[g][k][s];
            }
        }
        memcpy(z, next, 2 * STATES * sizeof *z);
#endif
        for (int u = 0; u < HIDDEN; ++u) {
            hidden[u] = hidden_bias[g][u];
        }
        for (int k = 0; k < READ; ++k) {
            for (int u = 0; u < HIDDEN; ++u) {
                hidden[u] += seen[k] * hidden_weight[g][k][u];
            }
        }
        for (int i = 0; i < PART_OUTPUTS; ++i) {
            double total = output_bias[g][i];
            for (int u = 0; u < HIDDEN; ++u) {
                total += fmax(hidden[u], 0.0) * output_weight[g][u][i];
            }
            y[g * PART_OUTPUTS + i] = total;
        }
    }
}
