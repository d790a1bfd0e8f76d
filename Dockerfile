# limo without training: `docker build -t limo .`, then `docker run --rm -v "$PWD:/data" limo demo --out demo`.
# Not tried where it was written, which has no Docker engine.
FROM python:3.13-slim
COPY . /limo
# The headers that come with pinocchio are a sixth of it, and nothing here compiles C++.
RUN pip install --no-cache-dir --no-compile -r /limo/requirements-light.txt \
    && pip install --no-cache-dir --no-compile --no-deps /limo \
    && rm -rf /limo /usr/local/lib/python3.13/site-packages/cmeel.prefix/include
WORKDIR /data
ENTRYPOINT ["limo"]
CMD ["--help"]
