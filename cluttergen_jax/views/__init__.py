"""Views: what cameras see of scenes, by one maker, and the formats that write them."""
